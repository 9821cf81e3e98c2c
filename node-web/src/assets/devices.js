// What an observer asks first of each kind of device: words of state, then values. The inspector has everything.
import { elapsed } from "./elapsed.js";
import { declination, duration, number, plain, rightAscension } from "./format.js";
import { ageOf, quality, skyNow, skySpeed, useTopic } from "./store.js";

/** Is there a value, and not the reason of its absence? */
export const known = (value) => value !== null && value !== undefined && !(typeof value === "object" && "no_data" in value);
const when = (value, words) => (known(value) ? words(value) : null);
const word = (value) => String(value).replaceAll("_", " ");

/** Of each kind: its icon, its state in words, and pairs of value and unit. */
export const KINDS = {
  telescope: { icon: "scope", state: (f) => (f.at_park === true ? "parked" : f.slewing === true ? "slewing" : f.tracking === true ? "tracking" : known(f.tracking) ? "not tracking" : "not known"),
    values: (f) => [when(f.ra_deg, (v) => [rightAscension(v), "RA"]), when(f.dec_deg, (v) => [declination(v), "Dec"]), when(f.altitude_deg, (v) => [`${number(v)}°`, "alt"]),
      when(f.azimuth_deg, (v) => [`${number(v)}°`, "az"]), when(f.pier_side, (v) => v !== "unknown" && [v, "pier"])] },
  dome: { icon: "open", state: (f) => [when(f.shutter, word) ?? "shutter not known", f.slewing === true && "turning", f.slaved === true && "follows the mount"].filter(Boolean).join(", "),
    values: (f) => [when(f.azimuth_deg, (v) => [`${number(v)}°`, "az"]), f.at_park === true && ["parked", ""]] },
  camera: { icon: "camera", state: (f) => when(f.activity, word) ?? "not known",
    values: (f) => [when(f.ccd_c, (v) => [number(v), "°C"]), when(f.set_c, (v) => [number(v), "°C wanted"]), when(f.cooler_percent, (v) => [number(v, 0), "% cooler"]), f.cooler_on === false && ["off", "cooler"],
      when(f.spool_free_bytes, (v) => [(v / 1e9).toFixed(0), "GB spool free"]), f.spooled ? [f.spooled, "not yet archived"] : null] },
  filterwheel: { icon: "wheel", state: (f) => when(f.filter, word) ?? f.position?.no_data ?? "turning", values: (f) => [when(f.position, (v) => [v, "slot"])] },
  focuser: { icon: "focus", state: (f) => (f.moving === true ? "moving" : known(f.position) ? "still" : "not known"), values: (f) => [when(f.position, (v) => [v.toLocaleString("en").replaceAll(",", " "), "steps"]), when(f.temperature_c, (v) => [number(v), "°C"])] },
  rotator: { icon: "clock", state: (f) => (f.moving === true ? "moving" : known(f.position_deg) ? "still" : "not known"), values: (f) => [when(f.position_deg, (v) => [`${number(v, 2)}°`, "sky"]), when(f.mechanical_deg, (v) => [`${number(v, 2)}°`, "mechanical"])] },
  covercalibrator: { icon: "cover", state: (f) => when(f.cover, (v) => `cover ${word(v)}`) ?? "not known", values: (f) => [when(f.calibrator, (v) => [word(v), "lamp"]), when(f.brightness, (v) => v > 0 && [v, "brightness"])] },
  switch: { icon: "plug", state: (f) => (Array.isArray(f.values) ? `${f.values.filter((v) => v > 0).length} of ${f.values.length} on` : "not known"), values: (f) => [Array.isArray(f.values) && [f.values.map(plain).join(" · "), ""]] },
  observingconditions: { icon: "cloud", state: () => "measures", values: (f) => [when(f.wind_mps, (v) => [number(v), "m/s"]), when(f.gust_mps, (v) => [number(v), "m/s gusts"]), when(f.humidity_percent, (v) => [number(v, 0), "% RH"]),
    when(f.air_c, (v) => [number(v), "°C"]), when(f.sky_c, (v) => [number(v), "°C sky"]), when(f.rain_mm_per_h, (v) => [v > 0 ? number(v) : "no", v > 0 ? "mm/h rain" : "rain"]), when(f.cloud_percent, (v) => [number(v, 0), "% cloud"])] },
  safetymonitor: { icon: "safe", state: (f) => when(f.is_safe, (v) => (v ? "says safe" : "says UNSAFE")) ?? "not known", values: (f) => [f.gapless_safe_s ? [duration(f.gapless_safe_s), "without a break"] : null] },
};

/** The devices among the states of a telescope's topic, in the order of the table above, shared ones last; `silent` is how long one that is lost has not answered, s. */
export function devicesOf(states) {
  const order = Object.keys(KINDS);
  return [...(states ?? [])].filter(([key]) => /^[^/]+\/[^/]+\/device\/[^/]+\/[^/]+\/state$/.test(key)).map(([key, entry]) => {
    const [site, telescope, , kind, name] = key.split("/");
    const age = ageOf(entry);
    const lost = entry.body?.link?.is === "lost";
    return { key, site, telescope, kind, name, entry, body: entry.body ?? {}, fields: entry.body?.fields ?? {}, age, worth: lost ? "lost" : quality(age, entry.period_s), lost, silent: lost ? (elapsed() - entry.lostAt) / 1000 : age, about: states.get(key.replace(/state$/, "capabilities"))?.body,
      icon: KINDS[kind]?.icon ?? "plug" };
  }).sort((a, b) => Number(a.telescope === "shared") - Number(b.telescope === "shared") || order.indexOf(a.kind) - order.indexOf(b.kind) || a.name.localeCompare(b.name));
}

/** The state of a key: its body, what it is worth, and until when it is known, ms of the sky: without end while it is fresh, else the time of the last one. @returns {{ body: any, worth: string, until: number | null, age: number | null }} */
export function stateOf(states, key) {
  const entry = states?.get(key);
  if (!entry) return { body: null, worth: "lost", until: null, age: null };
  const age = ageOf(entry);
  const worth = quality(age, entry.period_s);
  return { body: entry.body, worth, until: worth === "fresh" ? Infinity : Date.parse(entry.at_utc), age };
}

/** Its state in words. */
export function stateWords(device) {
  if (device.worth === "lost") return device.lost ? "does not answer" : "silent";
  if (device.body.link?.is === "connecting") return "connecting";
  return (KINDS[device.kind]?.state(device.fields) ?? "") || (device.body.busy ? "busy" : "ready");
}

/** Kinds of devices that an action needs, if not all that point and expose. */
const NEEDS = { cool_camera: ["camera"], calibration: ["camera", "filterwheel"], open: ["dome", "telescope", "covercalibrator"], close: ["dome", "telescope", "covercalibrator"], complete_headers: [] };
const ALL = ["telescope", "dome", "camera", "filterwheel", "focuser", "rotator", "covercalibrator"];

/** The devices that the action under way needs and that do not answer; `states` where the page has those of the telescope. */
export function useMissing(summary, now, states = null) {
  const asked = useTopic(!states && summary.device_count?.lost > 0 ? `tel/${summary.id}/device` : null);
  const [action] = now.fresh ? summary.activity ?? [] : [];
  const needs = action ? NEEDS[action.action] ?? ALL : [];
  return devicesOf(states ?? asked).filter((device) => device.worth === "lost" && device.telescope !== "shared" && needs.includes(device.kind) && (device.kind !== "camera" || !action.camera || device.name === action.camera)).map((device) => {
    const alert = `device-lost/${device.kind}/${device.name}`;
    const raised = summary.alerts?.find((one) => one?.id === alert)?.raised_utc;
    return { ...device, alert, silent: Math.max(device.silent, raised ? (skyNow() - Date.parse(raised)) / 1000 / skySpeed() : 0) };
  });
}

/** Pairs of value and unit. */
export const values = (device) => (KINDS[device.kind]?.values(device.fields) ?? []).filter(Boolean);

/** Exposure of a camera as a part from 0 to 1, ticking with sky time; null when none is under way. */
export function exposure(states, id, camera) {
  const entry = states?.get(`${id}/device/camera/${camera}/state`);
  const under = entry?.body.fields?.exposure;
  if (!under || quality(ageOf(entry), entry.period_s) !== "fresh" || skyNow() === null) return null;
  const passed = (skyNow() - Date.parse(under.started_utc)) / 1000;
  return { part: Math.min(1, Math.max(0, passed / under.exposure_s)), passed: Math.min(passed, under.exposure_s), total: under.exposure_s };
}
