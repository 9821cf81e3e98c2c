// The night of one telescope on one axis: twilight, altitude of targets and Moon, what was planned, what was done, and what is forecast.
import { html, useEffect, useRef, useSignal } from "./lib.js";
import { altaz, moon, twilight } from "./astro.js";
import { clock, hourMinute } from "./format.js";

const LANE = 25;
const TOP = 22;
const FOOT = 20;
const utc = (value) => Date.parse(value);

/** Full hours, or less, that fit. */
function ticks(t0, t1, px) {
  const every = [15, 30, 60, 120, 180, 360].find((minutes) => ((t1 - t0) / 6e4 / minutes) * 58 < px) * 6e4;
  const out = [];
  for (let t = Math.ceil(t0 / every) * every; t <= t1; t += every) out.push(t);
  return out;
}

/** From an hour before sunset to an hour after sunrise, around a moment. */
export function nightSpan(site, moment, rows) {
  const bands = site ? twilight(moment - 18 * 3600e3, moment + 18 * 3600e3, site) : [];
  const dark = bands.filter((band) => band.kind !== "day");
  let [from, to] = [moment - 6 * 3600e3, moment + 6 * 3600e3];
  const groups = [];
  for (const band of dark) {
    const last = groups[groups.length - 1];
    if (last && band.from - last[1] < 6e4) last[1] = band.to;
    else groups.push([band.from, band.to]);
  }
  const mine = groups.find(([a, b]) => moment >= a - 3600e3 && moment <= b + 3600e3) ?? groups.find(([a]) => a > moment);
  if (mine) [from, to] = [mine[0] - 3600e3, mine[1] + 3600e3];
  for (const row of rows) {
    if (utc(row.start_utc) > from - 6 * 3600e3 && utc(row.start_utc) < from) from = utc(row.start_utc);
    if (utc(row.end_utc) < to + 6 * 3600e3 && utc(row.end_utc) > to) to = utc(row.end_utc);
  }
  return [from, to];
}

/**
 * `rows`: windows with status; `plan`: rows of a forecast with `runs_utc` and `altitude_curve`; `done`: pieces of the night's report; `site`; `now`. Any may be absent.
 */
export function Night({ rows = [], plan = [], done = [], site, now, label = "The night" }) {
  const place = useRef(null);
  const width = useSignal(900);
  useEffect(() => {
    const observer = new ResizeObserver(() => { if (place.current) width.value = Math.max(280, place.current.clientWidth); });
    observer.observe(place.current);
    return () => observer.disconnect();
  }, []);
  const small = width.value < 560;
  const [from, to] = nightSpan(site, now, rows);
  const [t0, t1] = small ? [Math.max(from, now - 3 * 3600e3), Math.min(to, now + 4 * 3600e3)] : [from, to];
  if (!(t1 > t0)) return html`<div ref=${place}><p class="m">Nothing is planned around now.</p></div>`;
  const left = small ? 48 : 74;
  const W = width.value;
  const X = (t) => left + ((t - t0) / (t1 - t0)) * (W - left - 4);
  const chart = small ? 84 : 112;
  const Y = (altitude) => TOP + chart - (Math.max(0, altitude) / 90) * chart;
  const lanes = ["plan", "done"];
  const H = TOP + chart + 8 + lanes.length * LANE + FOOT;
  const path = (points) => points.map(([t, altitude], i) => (altitude === null ? "" : `${i && points[i - 1][1] !== null ? "L" : "M"}${X(t).toFixed(1)} ${Y(altitude).toFixed(1)}`)).join("");
  const track = [];
  if (site) for (let t = t0; t <= t1; t += 6e5) { const { alt } = altaz(moon(t), t, site); track.push([t, alt > 0 ? alt : null]); }
  const box = (a, b, cls, text, y, key, title) => {
    const [x, w] = [X(Math.max(a, t0)), Math.max(1.5, X(Math.min(b, t1)) - X(Math.max(a, t0)))];
    if (b < t0 || a > t1) return null;
    return html`<g key=${key}><title>${title ?? text}</title><rect class=${cls} x=${x.toFixed(1)} y=${y + 1} width=${w.toFixed(1)} height="18" rx="3" />${text && w > text.length * 6.4 + 8 && html`<text x=${x + 6} y=${y + 14} class=${/b-(done|run)/.test(cls) ? "on" : "in"}>${text}</text>`}</g>`;
  };
  const laneY = (i) => TOP + chart + 8 + i * LANE;
  const KIND = { open_shutter: "b-done", weather: "b-stop", fault: "b-gone" };
  return html`<div class="tl" ref=${place}><svg viewBox=${`0 0 ${W} ${H}`} height=${H} role="img" aria-label=${`${label}: ${rows.map((row) => `${row.action} ${row.object ?? ""} ${hourMinute(row.start_utc)} to ${hourMinute(row.end_utc)}, ${row.status}`).join("; ")}`}>
    ${site && twilight(t0, t1, site).map((band) => html`<rect key=${band.from} class=${`tw-${band.kind}`} x=${X(band.from).toFixed(1)} y=${TOP} width=${(X(band.to) - X(band.from) + 0.6).toFixed(1)} height=${H - TOP - FOOT} />`)}
    ${ticks(t0, t1, W - left).map((t) => html`<g key=${t}><path class="ax" d=${`M${X(t)} ${TOP}V${H - FOOT}`} /><text x=${X(t)} y=${H - 5} text-anchor="middle">${hourMinute(t)}</text></g>`)}<text x=${left - 8} y=${H - 5} text-anchor="end">UTC</text>
    ${[0, 30, 60].map((altitude) => html`<text key=${altitude} x=${left - 8} y=${Y(altitude) + 4} text-anchor="end">${altitude ? `${altitude}°` : "altitude"}</text>`)}<path class="lim" d=${`M${left} ${Y(30)}H${W - 4}`} />
    <path class="ln moonln" d=${path(track)} />${plan.filter((row) => row.altitude_curve?.length).map((row) => html`<path key=${row.row} class="ln s4" d=${path(row.altitude_curve.map((point) => [utc(point.at_utc), point.altitude_deg]))}><title>${row.object ?? ""}</title></path>`)}
    ${lanes.map((name, i) => html`<text key=${name} x=${left - 8} y=${laneY(i) + 14} text-anchor="end">${name}</text>`)}
    ${rows.map((row) => box(utc(row.start_utc), utc(row.end_utc), row.status === "failed" ? "b-err" : "b-plan", row.object ?? row.action, laneY(0), `r${row.row}`, `${row.row + 1}. ${[row.action, row.object].filter(Boolean).join(" ")}, ${row.status}${row.detail ? `: ${row.detail}` : ""}`))}
    ${done.filter((piece) => KIND[piece.group] && utc(piece.to_utc) - utc(piece.from_utc) > 2000).map((piece, i) => box(utc(piece.from_utc), utc(piece.to_utc), KIND[piece.group], piece.group === "open_shutter" ? "" : piece.kind, laneY(1), `d${i}`, `${clock(piece.from_utc)} to ${clock(piece.to_utc)}: ${piece.kind}`))}
    ${plan.flatMap((row) => (row.runs_utc ?? []).filter(([, end]) => utc(end) > now).map(([a, b], i) => box(Math.max(now, utc(a)), utc(b), "b-next", row.object ?? row.action, laneY(1), `f${row.row} ${i}`, `forecast: ${row.action} ${row.object ?? ""} ${hourMinute(a)} to ${hourMinute(b)}`)))}
    ${now >= t0 && now <= t1 && html`<path class="now" d=${`M${X(now)} 6V${H - FOOT}`} /><rect class="nowflag" x=${X(now) + 2} y="4" width="62" height="17" rx="4" /><text class="nowt" x=${X(now) + 33} y="16.5" text-anchor="middle">now ${hourMinute(now)}</text>`}</svg></div>`;
}
