// The device table: link, key values, and the age of every value.
import { h } from "./dom.js";
import { duration, declination, field, number, plain, rightAscension } from "./format.js";
import { ageOf, quality, skyNow, store } from "./link.js";
import { ageCell } from "./overview.js";

const open = new Set();
const known = (value) => value !== null && value !== undefined && !(typeof value === "object" && "no_data" in value);
const when = (value, words) => (known(value) ? words(value) : null);
const is = (value, word) => (value === true ? word : null);

/** What an observer asks first of each kind: words of state, then values. Anything else is in the expanded row. */
const KINDS = {
  telescope: (f) => [
    is(f.at_park, "parked") ?? is(f.slewing, "slewing") ?? is(f.tracking, "tracking") ?? (known(f.tracking) ? "not tracking" : "—"),
    when(f.ra_deg, (v) => `RA ${rightAscension(v)}`), when(f.dec_deg, (v) => `Dec ${declination(v)}`),
    when(f.altitude_deg, (v) => `alt ${number(v)}°`), when(f.azimuth_deg, (v) => `az ${number(v)}°`),
    when(f.pier_side, (v) => v !== "unknown" && `pier ${v}`),
  ],
  camera: (f) => [
    when(f.activity, String) ?? "—", when(f.ccd_c, (v) => `${number(v)} °C`), when(f.set_c, (v) => `set ${number(v)} °C`),
    when(f.cooler_on, (v) => (v ? when(f.cooler_percent, (p) => `cooler ${number(p, 0)} %`) ?? "cooler on" : "cooler off")),
    f.spooled ? `${f.spooled} in spool` : null,
  ],
  dome: (f) => [
    when(f.shutter, (v) => `shutter ${v}`) ?? "—", is(f.slewing, "turning"), when(f.azimuth_deg, (v) => `az ${number(v)}°`), is(f.at_park, "parked"), is(f.slaved, "follows the mount"),
  ],
  filterwheel: (f) => [when(f.filter, String) ?? when(f.position, (v) => `slot ${v}`) ?? f.position?.no_data ?? "—"],
  focuser: (f) => [is(f.moving, "moving"), when(f.position, (v) => `${v} steps`) ?? "—", when(f.temperature_c, (v) => `${number(v)} °C`)],
  rotator: (f) => [is(f.moving, "moving"), when(f.position_deg, (v) => `${number(v)}°`) ?? "—"],
  covercalibrator: (f) => [when(f.cover, (v) => `cover ${v.replaceAll("_", " ")}`) ?? "—", when(f.calibrator, (v) => `lamp ${v.replaceAll("_", " ")}`)],
  switch: (f) => [Array.isArray(f.values) ? f.values.map(plain).join(" · ") : "—"],
  safetymonitor: (f) => [when(f.is_safe, (v) => (v ? "says safe" : "says UNSAFE")) ?? "—", f.gapless_safe_s ? `for ${duration(f.gapless_safe_s)}` : null],
  observingconditions: (f) => [
    when(f.wind_mps, (v) => `wind ${number(v)} m/s`), when(f.gust_mps, (v) => `gusts ${number(v)} m/s`), when(f.humidity_percent, (v) => `RH ${number(v, 0)} %`),
    when(f.air_c, (v) => `air ${number(v)} °C`), when(f.sky_c, (v) => `sky ${number(v)} °C`), when(f.rain_mm_per_h, (v) => (v > 0 ? `rain ${number(v)} mm/h` : "no rain")),
    when(f.cloud_percent, (v) => `cloud ${number(v, 0)} %`),
  ],
};
const ORDER = Object.keys(KINDS);

function linkWord(state) {
  const link = state.link?.is ?? "unknown";
  if (link === "lost") return h("span", { class: "tag high" }, `◆ no link`);
  if (link === "connecting") return h("span", { class: "muted" }, "connecting");
  return h("span", {}, state.busy ? "busy" : "ready");
}

function expanded(entry, age, about) {
  const { body } = entry;
  const readings = Object.entries(body.readings ?? {});
  const missing = Object.entries(body.fields ?? {}).filter(([, value]) => !known(value) && typeof value === "object" && value);
  const sent = Date.parse(entry.at_utc);
  const speed = store.sky?.speed || 1;
  return h("div", { class: "inside" },
    body.link?.is === "lost" && h("p", { class: "why" }, `No link: ${plain(body.link.reason)}`),
    about && h("p", { class: "muted" }, [about.device_name, about.driver, about.simulated && "simulated"].filter(Boolean).join(" · ")),
    body.last_command && h("p", { class: "muted" }, `last command: ${body.last_command.verb} by ${body.last_command.from}, ${body.last_command.outcome.is}`,
      body.last_command.outcome.reason ? ` (${body.last_command.outcome.reason})` : ""),
    h("table", { class: "readings" },
      h("thead", {}, h("tr", {}, ["property", "value", "age"].map((word) => h("th", { scope: "col" }, word)))),
      h("tbody", {},
        missing.map(([name, value]) => h("tr", { key: `f-${name}` }, h("th", { scope: "row" }, field(name, null)[0]), h("td", { class: "why" }, `— ${value.no_data}`), ageCell(age, quality(age, entry.period_s)))),
        readings.map(([name, reading]) => {
          // by the sender's own two stamps, plus how long ago they came: no clock but ours and the sender's is asked
          const own = age + Math.max(0, (sent - Date.parse(reading.at_utc)) / 1000 / speed);
          const value = "no_data" in reading ? h("td", { class: "why" }, `— ${reading.no_data}`) : h("td", {}, plain(reading.value), reading.unit ? ` ${reading.unit}` : "");
          return h("tr", { key: name, "data-reading": name }, h("th", { scope: "row" }, name), value, ageCell(own, quality(age, entry.period_s)));
        }))));
}

function row(key, entry, redraw) {
  const [site, telescope, , kind, name] = key.split("/");
  const age = ageOf(entry);
  const worth = quality(age, entry.period_s);
  const { body } = entry;
  const values = (KINDS[kind] ?? (() => []))(body.fields ?? {}).filter(Boolean);
  const isOpen = open.has(key);
  const id = `inside-${telescope}-${kind}-${name}`;
  const toggle = () => { if (!open.delete(key)) open.add(key); redraw(); };
  const about = store.states.get(`${site}/${telescope}/device/${kind}/${name}/capabilities`)?.body;
  const link = body.link?.is ?? "unknown";
  return [
    h("tr", { key, class: `device ${worth}${link === "lost" ? " nolink" : ""}`, "data-device": `${kind}/${name}`, "data-quality": worth, "data-link": link },
      h("th", { scope: "row" }, h("button", { class: "more", "aria-expanded": String(isOpen), "aria-controls": isOpen ? id : null, onclick: toggle },
        h("span", { "aria-hidden": "true" }, isOpen ? "▾ " : "▸ "), name), h("span", { class: "kind" }, telescope === "shared" ? `${kind}, shared` : kind)),
      h("td", { class: "linkcell" }, linkWord(body)),
      h("td", { class: "values" }, values.map((value, i) => h("span", { class: "value", key: i }, value))),
      ageCell(age, worth),
      h("td", { class: "period" }, `${plain(entry.period_s)} s`)),
    isOpen && h("tr", { key: `${key}+`, class: "inside-row", id }, h("td", { colspan: "5" }, expanded(entry, age, about))),
  ];
}

/** Exposure of a camera as a part from 0 to 1, ticking with sky time; null when none is under way. */
export function exposure(address, camera) {
  const entry = store.states.get(`${address}/device/camera/${camera}/state`);
  const under = entry?.body.fields?.exposure;
  if (!under || quality(ageOf(entry), entry.period_s) !== "fresh" || skyNow() === null) return null;
  const passed = (skyNow() - Date.parse(under.started_utc)) / 1000;
  return { part: Math.min(1, Math.max(0, passed / under.exposure_s)), passed: Math.min(passed, under.exposure_s), total: under.exposure_s };
}

/** The table of all devices of the shown telescope and of what its site shares. */
export function devices(redraw) {
  const rows = [...store.states].filter(([key]) => /^[^/]+\/[^/]+\/device\/[^/]+\/[^/]+\/state$/.test(key));
  const order = (key) => { const [, telescope, , kind, name] = key.split("/"); return [telescope === "shared" ? 1 : 0, String(ORDER.indexOf(kind)).padStart(2, "0"), name].join("/"); };
  rows.sort(([a], [b]) => order(a).localeCompare(order(b)));
  if (!rows.length) return h("p", { class: "muted" }, "no device has published yet");
  return h("table", { class: "devices" },
    h("thead", {}, h("tr", {}, ["device", "state", "values", "age", "period"].map((word) => h("th", { scope: "col" }, word)))),
    h("tbody", {}, rows.map(([key, entry]) => row(key, entry, redraw))));
}
