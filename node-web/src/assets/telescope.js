// One telescope: may it be open, what does it do, what does each part say, and how old is that.
import { guarded, h } from "./dom.js";
import { devices, exposure } from "./devices.js";
import { clock, day, duration, hourMinute, number, plain, PRIORITY } from "./format.js";
import { ageOf, quality, skyNow, store } from "./link.js";
import { activity, ageCell, ageMark, arrived, domes, picture, standing, unreadable, words } from "./overview.js";

const LEVELS = ["error", "warn", "info"];
const SHAPES = { pending: "·", running: "▶", interrupted: "‖", finished: "✓", failed: "✕", skipped: "–" };
let level = "info";
let redraw = () => {};

const section = (name, title, ...inside) => h("section", { key: name, class: `panel ${name}`, "aria-labelledby": `h-${name}` }, h("h2", { id: `h-${name}` }, title), inside);
const stateOf = (address, name) => store.states.get(`${address}/observatory/${name}/state`);
const utcRange = (from, to) => `${hourMinute(from)}–${hourMinute(to)}`;
const entryAge = (entry) => ageMark(ageOf(entry), quality(ageOf(entry), entry.period_s));

function banner(summary, now) {
  const { safety } = summary;
  const toSafe = now.fresh && safety.state !== "safe" && safety.time_to_safe_s != null ? `safe in at least ${duration(safety.time_to_safe_s)}` : null;
  return h("section", { key: "banner", class: `panel banner ${now.worth}${now.concern ? ` ${now.concern}` : ""}`, "aria-label": "safety and posture" },
    h("p", { class: "words big", "data-safety": now.safety, "data-posture": now.posture, "data-mode": now.mode, "aria-live": "assertive", "aria-atomic": "true" },
      words(now), now.mode !== "unknown" && h("span", { class: "word" }, now.mode.toUpperCase()), summary.simulated && h("span", { class: "word sim" }, "SIMULATION")),
    h("p", { class: "since" }, toSafe && h("strong", { "data-time-to-safe": safety.time_to_safe_s }, `${toSafe}. `),
      now.fresh && safety.since_utc && `${safety.state} since ${clock(safety.since_utc)}, `, now.fresh ? "received " : store.link !== "live" && `last received: ${safety.state.toUpperCase()}, ${summary.posture.toUpperCase()}, `, ageMark(now.age, now.worth, " ago")),
    domes(summary, now),
    store.link === "live" && [["", safety.reasons], ["No exposures of the sky: ", safety.suspended], ["Near a limit: ", safety.advisories]].map(([lead, list]) =>
      list.length > 0 && h("ul", { key: lead, class: "reasons" }, list.map((reason) => h("li", { key: reason.input }, lead,
        h("strong", {}, reason.input), ` ${reason.why}`, reason.clears_in_s != null && h("span", { class: "muted" }, ` (can clear in ${duration(reason.clears_in_s)})`))))));
}

/** What became of an alert, in words. */
function fate(alert) {
  const words = [
    alert.returned_utc && `returned ${clock(alert.returned_utc)}, nobody has acknowledged it`,
    alert.acknowledged_by && `acknowledged by ${alert.acknowledged_by}`,
    alert.shelved_until_utc && `shelved until ${clock(alert.shelved_until_utc)}: ${alert.shelved_reason}`,
  ];
  return words.filter(Boolean).map((word) => ` · ${word}`).join("");
}

function alerts(summary) {
  if (!summary.alerts.length) return null;
  return section("alerts", `Alerts (${summary.alerts.length})`, h("ul", {}, summary.alerts.map((alert) => {
    return h("li", { key: alert.id, "data-alert": alert.id }, h("span", { class: `tag ${alert.priority}` }, `${PRIORITY[alert.priority] ?? "?"} ${alert.priority}`),
      h("div", {}, h("strong", {}, alert.cause), h("p", {}, `${alert.consequence} `, h("em", {}, alert.action)), h("p", { class: "muted" }, `${alert.id} · since ${clock(alert.raised_utc)}${fate(alert)}`)));
  })));
}

function doing(summary, now) {
  const actions = now.fresh ? summary.activity : [];
  const facts = [`${summary.frames} frames`, summary.schedule && `${summary.schedule.finished} of ${summary.schedule.rows} rows done`].filter(Boolean).join(" · ");
  return section("now", "Now",
    actions.map((action) => {
      const light = exposure(summary.id, action.camera);
      return h("div", { class: "action", key: `${action.row}-${action.camera}`, "data-action": action.action },
        h("p", { class: "what" }, h("strong", {}, [action.action, action.object].filter(Boolean).join(" ")), h("span", { class: "muted" }, ` row ${action.row}, ${action.camera}, since ${clock(action.started_utc)}`)),
        h("p", { class: "step" }, action.step || "…"),
        light && h("p", { class: "light" }, h("progress", { max: "1", value: light.part.toFixed(3), "aria-label": "exposure" }), ` ${number(light.passed, 0)} of ${plain(light.total)} s`));
    }),
    !actions.length && h("p", { class: "step" }, activity(summary, now) || "not known"),
    h("p", { class: "muted" }, facts));
}

function image(summary) {
  const shown = arrived(summary);
  const age = shown && ageOf(shown);
  const facts = store.states.get(`${summary.id}/observatory/frame/facts`)?.body;
  const measured = shown && facts?.frame === shown.frame ? [facts.stars != null && `${facts.stars} stars`, facts.fwhm_px != null && `FWHM ${number(facts.fwhm_px)} px`, facts.sky_adu != null && `sky ${number(facts.sky_adu, 0)} ADU`, facts.trailed && "trailed", facts.reason].filter(Boolean) : [];
  return section("image", "Latest image",
    shown ? [picture(shown, "large"),
      h("p", { class: "caption", key: "caption" }, h("strong", {}, shown.object ?? shown.image_type), ` ${shown.filter ?? "no filter"} · ${plain(shown.exposure_s)} s · ${shown.camera} · ${clock(shown.started_utc)} · `,
        h("span", { class: "age", "data-age": Math.floor(age) }, `${duration(age)} ago`)),
      measured.length > 0 && h("p", { class: "caption", key: "measured" }, measured.join(" · ")),
      h("p", { class: "muted id", key: "id" }, shown.frame),
      shown.problem && h("p", { class: "why", key: "problem" }, shown.problem)]
      : h("p", { class: "muted" }, "no frame yet"));
}

function schedule(address) {
  const entry = stateOf(address, "schedule");
  if (!entry) return section("schedule", "Schedule", h("p", { class: "muted" }, "no schedule received yet"));
  const { rows, file, revision, refused } = entry.body;
  return section("schedule", "Schedule",
    h("p", { class: "muted" }, `${file}, version ${revision} · `, entryAge(entry)),
    refused && h("p", { class: "why" }, h("span", { class: "tag medium" }, "▼ not taken"), ` ${refused}`),
    h("div", { class: "scroll", tabindex: "0", role: "region", "aria-labelledby": "h-schedule" }, h("table", { class: "rows" },
      h("thead", {}, h("tr", {}, ["row", "what", "window", "frames", "status"].map((word) => h("th", { scope: "col" }, word)))),
      h("tbody", {}, rows.map((row) => h("tr", { key: row.row, class: row.status, "data-row": row.row, "data-status": row.status },
        h("td", {}, String(row.row)), h("td", {}, [row.action, row.object].filter(Boolean).join(" "), h("span", { class: "muted" }, ` ${row.camera}`)),
        h("td", {}, utcRange(row.start_utc, row.end_utc)), h("td", {}, row.frames || row.frames_wanted ? `${row.frames}${row.frames_wanted != null ? ` of ${row.frames_wanted}` : ""}` : ""),
        h("td", {}, h("span", { "aria-hidden": "true" }, `${SHAPES[row.status] ?? "?"} `), row.status, row.detail && h("span", { class: "muted" }, ` ${row.detail}`))))))));
}

function verdict(address) {
  const entry = stateOf(address, "safety");
  if (!entry?.body.inputs?.length) return null;
  const since = ageOf(entry);
  return section("inputs", "What the verdict rests on", h("table", {},
    h("thead", {}, h("tr", {}, ["input", "value", "age", "speaks for"].map((word) => h("th", { scope: "col" }, word)))),
    h("tbody", {}, entry.body.inputs.map((input) => h("tr", { key: input.input, class: input.good ? "" : "bad", "data-input": input.input },
      h("th", { scope: "row" }, input.input), h("td", {}, input.value),
      ageCell(input.age_s == null ? null : input.age_s + since, input.age_s == null ? "never" : quality(since, entry.period_s)),
      h("td", {}, input.good ? "safe" : h("strong", {}, "✕ unsafe")))))));
}

function command(address) {
  const lease = stateOf(address, "lease");
  const guards = [...store.states].filter(([key]) => key.endsWith("/guard"));
  if (!lease && !guards.length) return null;
  const fact = (name, ...value) => [h("dt", { key: `t${name}` }, name), h("dd", { key: `d${name}` }, value)];
  return section("command", "Command and guard", h("dl", {},
    lease && fact("commander", lease.body.holder ? `${lease.body.holder}, token ${lease.body.token}, granted by ${lease.body.arbiter} · ` : "nobody · ", entryAge(lease)),
    guards.map(([key, entry]) => {
      const { body } = entry;
      const left = body.permits.map((permit) => `${permit.telescope} ${permit.safe ? "safe" : "unsafe"}, ${number(permit.left_s - ageOf(entry), 0)} s left`).join("; ");
      return fact(`guard of ${key.split("/")[4]}`, body.may_be_open ? "may be open" : "must be closed", body.action === "closing" ? h("strong", {}, ", closing") : "", body.hold ? h("strong", {}, ", on hold") : "",
        left ? ` (${left})` : " (no permit)", body.dropped ? `, ${body.dropped} permits dropped` : "", " · ", entryAge(entry));
    })));
}

/** Ids are long and alike: their end tells them apart. */
const shorter = (value) => (/^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$/.test(value) ? `…${value.slice(-8)}` : value);

function log() {
  const shown = store.log.filter((line) => LEVELS.indexOf(line.level) <= LEVELS.indexOf(level)).slice(0, 200);
  const choose = (word) => () => { level = word; redraw(); };
  return section("log", "Log",
    h("div", { class: "levels", role: "group", "aria-label": "show" }, ["info", "warn", "error"].map((word) =>
      h("button", { key: word, "aria-pressed": String(level === word), onclick: choose(word) }, { info: "all", warn: "warnings", error: "errors" }[word]))),
    h("ol", { class: "lines scroll", tabindex: "0", "data-log": shown.length, "aria-label": "log lines, newest first" },
      shown.map((line) => h("li", { key: line.number, class: line.level, "data-level": line.level }, h("time", { datetime: line.at_utc }, clock(line.at_utc)), " ",
        line.level !== "info" && h("span", { class: `level ${line.level}` }, `${line.level.toUpperCase()} `), h("span", { class: "node" }, line.node), " ", h("span", { class: "message" }, line.message),
        h("span", { class: "fields" }, Object.entries(line.fields ?? {}).map(([name, value]) => ` ${name}=${shorter(value)}`).join("")))),
      !shown.length && h("li", { key: "none", class: "muted" }, "no lines yet")));
}

function nodes() {
  const shown = [...store.states].filter(([key]) => /\/node\/[^/]+\/[^/]+\/state$/.test(key));
  if (!shown.length) return null;
  return section("nodes", "Nodes", h("table", {},
    h("thead", {}, h("tr", {}, ["node", "host", "version", "up", "age"].map((word) => h("th", { scope: "col" }, word)))),
    h("tbody", {}, shown.map(([key, entry]) => {
      const [, telescope, , role, id] = key.split("/");
      const age = ageOf(entry);
      return h("tr", { key, "data-node": `${role}/${id}` }, h("th", { scope: "row" }, `${role} ${id}`, telescope === "shared" && h("span", { class: "muted" }, " shared")),
        h("td", {}, entry.body.host || "–"), h("td", {}, entry.body.version), h("td", {}, duration(entry.body.uptime_s + age)), ageCell(age, quality(age, entry.period_s)));
    }))));
}

/** The page of one telescope. */
export function telescope(address, again) {
  redraw = again;
  const summary = store.net.get(address);
  if (!summary) {
    if (store.link !== "live") return h("p", { class: "empty" }, "Connecting …");
    return [h("h1", { tabindex: "-1" }, address), h("p", { class: "empty" }, "Nothing of this telescope was received from the bus. ", h("a", { href: "/", "data-go": true }, "All telescopes"))];
  }
  const now = standing(summary);
  const head = h("div", { class: "title", key: "title" }, h("h1", { tabindex: "-1" }, summary.telescope_id), h("p", { class: "muted" }, summary.site_id, skyNow() ? ` · ${day(skyNow())}` : ""));
  const part = (name, draw) => guarded(name, draw);
  const own = part("devices", () => section("devices", "Devices", devices(redraw)));
  const common = { alerts: part("alerts", () => alerts(summary)), log: part("log", log), nodes: part("nodes", nodes), odd: part("unreadable", () => unreadable(summary)) };
  if (summary.shared) return [head, h("div", { class: "page shared", key: "page" }, common.odd, common.alerts, own, common.log, common.nodes)];
  return [head, h("div", { class: "page", key: "page" }, part("safety and posture", () => banner(summary, now)), common.odd, common.alerts,
    h("div", { class: "column", key: "left" }, part("now", () => doing(summary, now)), own, part("schedule", () => schedule(address)), common.log),
    h("div", { class: "column", key: "right" }, part("image", () => image(summary)), part("verdict", () => verdict(address)), part("command", () => command(address)), common.nodes))];
}
