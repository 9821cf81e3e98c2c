// Numbers, times and ages as an observer writes them.

const MINUS = "\u2212";

/** An age or a duration in seconds, in two units at most. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return "never";
  const s = Math.max(0, Math.floor(seconds));
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${s % 60} s`;
  if (s < 86400) return `${Math.floor(s / 3600)} h ${Math.floor((s % 3600) / 60)} min`;
  return `${Math.floor(s / 86400)} d ${Math.floor((s % 86400) / 3600)} h`;
}

/** `04:12:31` of a time in UTC. */
export function clock(utc) {
  const time = new Date(utc);
  return Number.isNaN(time.getTime()) ? "?" : time.toISOString().slice(11, 19);
}

/** `04:12` of a time in UTC. */
export const hourMinute = (utc) => clock(utc).slice(0, 5);

/** `Sat 21 Nov`. */
export function day(utc) {
  return new Date(utc).toLocaleDateString("en-GB", { weekday: "short", day: "numeric", month: "short", timeZone: "UTC" });
}

/** `21 Nov`. */
export const shortDay = (utc) => day(utc).split(" ").slice(1).join(" ");

/** A longer axis has its days, ms. */
const WITHIN_A_DAY = 20 * 3600e3;
/** A time of day on an axis of such a length, `04:12:31`; on one that is longer than 20 h with its day, `21 Nov 04:12:31`. */
export const clockOn = (span, utc) => (span > WITHIN_A_DAY ? `${shortDay(utc)} ${clock(utc)}` : clock(utc));
/** The label of an axis of such a length: its midnights are days. */
export const tickOn = (span, utc) => (span > WITHIN_A_DAY && utc % 86400e3 === 0 ? shortDay(utc) : hourMinute(utc));

/** A number with so many decimals and a true minus sign; what is rounded to nothing has none. */
export function number(value, decimals = 1) {
  return value.toFixed(decimals).replace(/^-(?=[0.]*$)/, "").replace(/^-/, MINUS);
}

/** Values of an axis with as many decimals as tell them apart. */
export function labels(ticks) {
  const step = Math.abs(ticks[1] - ticks[0]) || 1;
  const digits = [0, 1, 2, 3].find((n) => ticks.every((v) => Math.abs(v - Number(v.toFixed(n))) < step / 1000)) ?? 4;
  return ticks.map((v) => number(v, digits));
}

/** Right ascension in degrees as `23 06 29.3`. */
export function rightAscension(degrees) {
  return sexagesimal((((degrees / 15) % 24) + 24) % 24, 1, 24);
}

/** Declination in degrees as `−05 02 28`. */
export function declination(degrees) {
  return (degrees < 0 ? MINUS : "+") + sexagesimal(Math.abs(degrees), 0);
}

function sexagesimal(value, decimals, wrap = Infinity) {
  const unit = 10 ** decimals;
  let parts = Math.round(value * 3600 * unit);
  if (parts >= wrap * 3600 * unit) parts = 0;
  const two = (n) => String(n).padStart(2, "0");
  const seconds = ((parts % (60 * unit)) / unit).toFixed(decimals).padStart(decimals ? 3 + decimals : 2, "0");
  return `${two(Math.floor(parts / (3600 * unit)))} ${two(Math.floor(parts / (60 * unit)) % 60)} ${seconds}`;
}

/** @type {[string, string, number][]} */
const UNITS = [
  ["_mag_per_arcsec2", " mag/arcsec²", 2], ["_mm_per_h", " mm/h", 1], ["_arcsec", "″", 2], ["_percent", " %", 0],
  ["_hpa", " hPa", 0], ["_lux", " lx", 4], ["_mps", " m/s", 1], ["_deg_per_s", "°/s", 4], ["_deg", "°", 1], ["_bytes", "", 0], ["_px", " px", 1],
  ["_c", " °C", 1], ["_s", " s", 1], ["_m", " m", 0],
];

/** A typed field: its name without the unit, and its value with it. */
export function field(name, value) {
  const [suffix, unit, decimals] = UNITS.find(([suffix]) => name.endsWith(suffix)) ?? ["", "", 1];
  const label = name.slice(0, name.length - suffix.length).replaceAll("_", " ");
  if (suffix === "_bytes" && typeof value === "number") return [label, bytes(value)];
  if (typeof value === "number") return [label, (Number.isInteger(value) && !suffix ? String(value) : number(value, decimals)) + unit];
  return [label, plain(value)];
}

export function bytes(count) {
  const power = count < 1000 ? 0 : Math.min(5, Math.floor(Math.log10(count) / 3));
  return `${(count / 1000 ** power).toFixed(power ? 1 : 0)} ${["B", "kB", "MB", "GB", "TB", "PB"][power]}`;
}

/** Any value of a property. */
export function plain(value) {
  if (value === null || value === undefined) return "—";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value === "number") {
    const shown = Number.isInteger(value) || Math.abs(value) >= 1e6 || (value !== 0 && Math.abs(value) < 1e-3) ? String(value) : String(Number(value.toFixed(4)));
    return shown.replace(/^-/, MINUS);
  }
  if (Array.isArray(value)) return value.map(plain).join(", ");
  if (typeof value === "object") return "no_data" in value ? "—" : JSON.stringify(value);
  return String(value);
}

/** The name of a night, `20261120`, of a moment where UTC noon divides: arithmetic of dates alone, the present night is `tonight` of site.js. */
export const nightOf = (ms) => new Date(ms - 12 * 3600e3).toISOString().slice(0, 10).replaceAll("-", "");
/** `Fri 20 Nov` of a night's name. */
export const nightDay = (night) => day(`${night.slice(0, 4)}-${night.slice(4, 6)}-${night.slice(6, 8)}T12:00:00Z`);
