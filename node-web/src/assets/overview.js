// The network: one tile per telescope, the ones that need someone first.
import { guarded, h } from "./dom.js";
import { clock, duration, PRIORITY } from "./format.js";
import { quality, store, touch } from "./link.js";

/** How a summary stands now: its worth and age, judged here too, because words stop coming when the link is lost. */
export function standing(summary) {
  const age = summary.age_s === null ? null : summary.age_s + (performance.now() - summary.received) / 1000;
  const worth = age === null ? "never" : quality(age, 1);
  const fresh = worth === "fresh";
  const isOfDomes = store.link === "live" && summary.posture_by === "domes";
  const concern = fresh || isOfDomes ? summary.concern : store.link === "live" && age !== null && worth === "lost" ? summary.concern ?? "critical" : null;
  return {
    age,
    worth,
    concern: concern ?? null,
    safety: fresh ? summary.safety?.state ?? "unknown" : "unknown",
    // while the observatory node is silent the server goes by the domes' own device nodes
    posture: fresh || isOfDomes ? summary.posture : "unknown",
    mode: fresh ? summary.mode : "unknown",
    fresh,
  };
}

/** Counts of standing alerts, each with its shape; nothing when there are none. */
export function alertCounts(counts) {
  const shown = Object.keys(PRIORITY).map((priority) => [priority, counts[priority]]).filter(([, n]) => n > 0);
  if (!shown.length) return h("span", { class: "muted" }, "no alerts");
  return shown.map(([priority, n]) => h("span", { class: `tag ${priority}` }, `${PRIORITY[priority]} ${priority} × ${n}`));
}

/** An age that ticks, with the word for what it is worth. */
export function ageMark(age, worth, after = "") {
  const words = { fresh: "", stale: "stale ", lost: "lost ", never: "" }[worth];
  const shown = age === null ? "not received yet" : words + duration(age) + after;
  return h("span", { class: `age ${worth}`, "data-age": age === null ? "" : Math.floor(age), "data-quality": worth }, shown);
}

/** The same in a cell of a table. */
export const ageCell = (age, worth) => h("td", { class: "agecell" }, ageMark(age, worth));

const pictures = new Map();

/** The newest image of a telescope that has arrived here: the old one stays until the new one can be shown. */
export function arrived(summary) {
  const wanted = summary.image;
  const have = pictures.get(summary.id) ?? { shown: null, asked: null };
  pictures.set(summary.id, have);
  if (wanted && have.asked !== wanted.frame && store.link === "live") {
    have.asked = wanted.frame;
    const src = `/api/v1/telescopes/${summary.id}/image.jpg?frame=${encodeURIComponent(wanted.frame)}`;
    const since = summary.received - summary.image_age_s * 1000;
    const image = new Image();
    image.onload = () => {
      // an older one may arrive after a newer one
      if (have.asked === wanted.frame) have.shown = { ...wanted, src, since };
      touch();
    };
    image.onerror = () => { if (have.asked === wanted.frame) have.asked = null; };
    image.src = src;
  }
  return have.shown && { ...have.shown, problem: wanted?.problem };
}

/** The image itself. */
export function picture(image, size) {
  if (!image) return null;
  const what = `${image.image_type} ${image.object ?? ""}, ${image.filter ?? "no filter"}, ${image.exposure_s} s`;
  const [width, height] = image.size_px;
  return h("div", { class: `sky ${size}`, key: "sky" }, h("img", { "data-frame": image.frame, alt: what, width, height, src: image.src }));
}

/** What is done now, or the present reason why nothing is: the words of the server, which `starmesh status` prints too. */
export const activity = (summary, now) => (now.fresh || store.link === "live" ? summary.now : "");

/** Says that some of what is sent for a telescope cannot be read, so that what stands here of it is older. */
export function unreadable(summary) {
  const found = summary.unreadable ?? [];
  if (!found.length) return null;
  return h("p", { key: "unreadable", class: "why", "data-unreadable": found.length }, h("span", { class: "tag high" }, `◆ ${found.length} not readable`),
    ` ${found[0].key}: ${found[0].why}`, found.length > 1 && ` (and ${found.length - 1} more)`);
}

function tile(summary) {
  const now = standing(summary);
  const top = summary.alerts[0];
  const concern = now.concern ? ` ${now.concern}` : "";
  return h("a", {
    key: summary.id, class: `tile ${now.worth}${concern}`, href: `/t/${summary.id}`, "data-go": true, "data-telescope": summary.id,
    "data-safety": now.safety, "data-posture": now.posture, "data-mode": now.mode, "data-quality": now.worth,
  },
    h("div", { class: "tile-head" }, h("h3", {}, summary.telescope_id),
      h("span", { class: "modes" }, summary.simulated && h("span", { class: "word sim" }, "SIMULATION"), h("span", { class: "word" }, now.mode === "unknown" ? "" : now.mode.toUpperCase()))),
    h("p", { class: "words" }, words(now)),
    h("p", { class: "doing" }, activity(summary, now)),
    domes(summary, now),
    summary.schedule && h("p", { class: "muted" }, `${summary.schedule.finished} of ${summary.schedule.rows} rows done`, summary.schedule.failed ? `, ${summary.schedule.failed} failed or skipped` : "", ` · ${summary.frames} frames`),
    !navigator.connection?.saveData && picture(arrived(summary), "thumb"),
    unreadable(summary),
    top && h("p", { class: "top-alert" }, top.cause),
    summary.device_count.lost > 0 && h("p", {}, h("span", { class: "tag medium" }, `▼ ${summary.device_count.lost} of ${summary.device_count.known} devices silent`)),
    h("div", { class: "tile-foot" }, h("span", {}, alertCounts(summary.alert_counts)), ageMark(now.age, now.worth, " ago")));
}

/** While the observatory node is silent: how each dome stands, what closes it, and when. */
export function domes(summary, now) {
  const words = now.fresh || store.link !== "live" ? [] : summary.domes ?? [];
  return words.map((text) => h("p", { key: text.split(":")[0], class: "why", "data-dome": text.split(":")[0] }, text));
}

/** The two words, with the shape of what they mean together. */
export function words(now) {
  const shape = now.concern ? `${PRIORITY[now.concern]} ` : "";
  return [
    h("strong", { class: `safety ${now.safety}${now.concern ? ` ${now.concern}` : ""}` }, shape + now.safety.toUpperCase()),
    h("span", { class: "posture" }, now.posture === "unknown" ? "dome unknown" : now.posture.toUpperCase()),
  ];
}

const rank = (summary) => {
  const now = standing(summary);
  const { critical, high } = summary.alert_counts;
  return now.concern === "critical" || critical ? 0 : now.concern === "high" || high ? 1 : now.worth !== "fresh" ? 2 : 3;
};

/** The page. */
export function overview() {
  const all = [...store.net.values()];
  const telescopes = all.filter((summary) => !summary.shared);
  const sites = [...new Set(telescopes.map((summary) => summary.site_id))].sort();
  const live = telescopes.filter((summary) => standing(summary).fresh).length;
  if (!telescopes.length) return h("p", { class: "empty" }, store.link === "live" ? "No telescope on the bus yet. Nodes appear here by themselves." : "Connecting …");
  return [
    h("div", { class: "title" }, h("h1", { tabindex: "-1" }, "Network"), h("p", { class: "muted" }, `${live} of ${telescopes.length} telescopes live`)),
    sites.map((site) => {
      const here = telescopes.filter((summary) => summary.site_id === site);
      here.sort((a, b) => rank(a) - rank(b) || a.telescope_id.localeCompare(b.telescope_id));
      const shared = all.find((summary) => summary.shared && summary.site_id === site);
      return h("section", { key: site, "aria-label": `site ${site}` },
        h("div", { class: "site" }, h("h2", {}, site), shared && h("p", {},
          h("a", { href: `/t/${shared.id}`, "data-go": true }, "shared equipment"), " ",
          h("span", { class: shared.device_count.lost ? "tag medium" : "muted" }, `${shared.device_count.known - shared.device_count.lost} of ${shared.device_count.known} devices`))),
        h("div", { class: "tiles" }, here.map((summary) => guarded(summary.telescope_id, () => tile(summary)))));
    }),
  ];
}

/** When the newest word of a telescope was said, for the footer. */
export const reported = (summary) => (summary.reported_utc ? clock(summary.reported_utc) : "never");
