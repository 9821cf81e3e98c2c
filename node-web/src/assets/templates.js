// What a new row begins with: the parameters of the newest row of its kind, else of the action's example, with this telescope's camera and filters, in
// the darkness of tonight that is left.
import { nightAround, twilightOf } from "./night.js";
import { timeLike } from "./rowtext.js";

const MINUTE = 60e3;
const HOUR = 60 * MINUTE;
const DARKEST = ["night", "astro", "nautical", "civil"];
/** What comes before the first target. */
const FIRST = ["cool_camera", "open"];

/** Tonight in ms: sunset, begin and end of the darkest part, sunrise; without a site the hours from now on. */
function tonight(site, now) {
  const [sunset, sunrise] = nightAround(site, now) ?? [now, now + 10 * HOUR];
  const bands = site ? twilightOf(sunset, sunrise, site) : [];
  const kind = DARKEST.find((one) => bands.some((band) => band.kind === one));
  const dark = bands.filter((band) => band.kind === kind);
  return { sunset, sunrise, from: dark[0]?.from ?? sunset, to: dark[dark.length - 1]?.to ?? sunrise };
}

/** Begin and end of a new row, ms. */
function windowOf(action, rows, skyActions, night, now, length) {
  const whole = (ms) => Math.ceil(ms / MINUTE) * MINUTE;
  const sky = rows.filter((one) => skyActions.has(one.row.action_type) && !FIRST.includes(one.row.action_type));
  const last = Math.max(now, ...sky.map((one) => one.end).filter(Number.isFinite));
  const spanOf = (from, end) => { const after = Math.round((whole(from) + length) / MINUTE) * MINUTE; return [whole(from), end - from > 10 * MINUTE ? Math.min(Math.floor(end / MINUTE) * MINUTE, after) : after]; };
  if (FIRST.includes(action.name)) return spanOf(Math.max(now, night.sunset), action.name === "open" ? night.to : night.from);
  if (action.name === "flats") return last < night.from - 10 * MINUTE ? spanOf(Math.max(last, night.sunset), night.from) : spanOf(Math.max(last, night.to), night.sunrise);
  // Where none of the darkness is free, its last part: a row begins when those before it have ended, which may be before their window does.
  const free = night.to - last > 10 * MINUTE ? last : Math.max(now, night.to - length);
  if (action.needs_safe_sky) return spanOf(Math.max(free, night.from), night.to);
  return spanOf(Math.max(last, ...rows.map((one) => one.start + MINUTE).filter(Number.isFinite)), Infinity);
}

/** Parameters of an action for which there is no row yet. */
function valueOf(action, rows, filters) {
  const value = { ...action.example };
  const used = rows.map((one) => one.row.action_value?.filter).filter((one) => filters.includes(one)).pop() ?? filters[0];
  if (Array.isArray(value.filter) && filters.length) Object.assign(value, { filter: filters, n: filters.map(() => value.n?.[0] ?? 1) });
  else if ("filter" in value && used) value.filter = used;
  else if (!filters.length) delete value.filter;
  const exposures = [...new Set(rows.map((one) => one.row.action_value?.exptime).filter((one) => one > 0))].sort((a, b) => a - b);
  // Darks as long as the frames that need them.
  if (action.name === "calibration" && exposures.length) Object.assign(value, { exptime: [0, ...exposures], n: [0, ...exposures].map((time) => (time ? 5 : 10)) });
  return value;
}

/** The row with which a form of `action` begins; `list` are all actions. */
export function templateOf(action, { list, rows, cameras, filters, site, now }) {
  const like = rows.filter((one) => one.row.action_type === action.name).pop();
  const last = rows[rows.length - 1]?.row;
  const length = Math.min(12 * HOUR, Math.max(10 * MINUTE, like?.end - like?.start || HOUR));
  const skyActions = new Set(list.filter((one) => one.needs_safe_sky).map((one) => one.name));
  const [from, to] = windowOf(action, rows, skyActions, tonight(site, now), now, length);
  return { device_name: like?.row.device_name ?? last?.device_name ?? cameras[0] ?? "", action_type: action.name, action_value: { ...(like?.row.action_value ?? valueOf(action, rows, filters)) },
    start_time: timeLike(last?.start_time, from), end_time: timeLike(last?.end_time, to), programme: (like?.row ?? last)?.programme };
}
