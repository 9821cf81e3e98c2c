// The night on one axis: twilight, altitude of targets and Moon, what was planned, what was done, and what is forecast; of one telescope, or of all.
import { html, useEffect, useMemo, useRef, useSignal } from "./lib.js";
import { useReport } from "./api.js";
import { altaz, moon, ofDate, twilight } from "./astro.js";
import { clock, hourMinute, number } from "./format.js";
import { inputWords } from "./inputs.js";
import { Old, SIGNS, answeredAt, priorityNumber, standing } from "./parts.js";
import { siteOf, tonight } from "./site.js";
import { net, useTopic } from "./store.js";
import { TimeTools, useTimeView } from "./timeview.js";

const LANE = 25;
const TOP = 22;
const FOOT = 20;
const HOUR = 3600e3;
const utc = (value) => Date.parse(value);
const words = (text) => String(text ?? "").replaceAll("_", " ");

/** Full hours, or less, that fit. */
export function ticks(t0, t1, px) {
  const every = [1, 2, 5, 10, 15, 30, 60, 120, 180, 360].find((minutes) => ((t1 - t0) / 6e4 / minutes) * 58 < px) * 6e4;
  const out = [];
  for (let t = Math.ceil(t0 / every) * every; t <= t1; t += every) out.push(t);
  return out;
}

/** The same bands are drawn each second. */
const known = new Map();
export function twilightOf(t0, t1, site) {
  const name = `${site.lat} ${site.lon} ${t0} ${t1}`;
  if (!known.has(name)) {
    if (known.size > 60) known.clear();
    known.set(name, twilight(t0, t1, site));
  }
  return known.get(name);
}

/** Sunset and sunrise of the night around a moment, or of the next one; null where that is not known. */
export function nightAround(site, time) {
  const moment = Math.floor(time / 6e5) * 6e5;
  const groups = [];
  for (const band of site ? twilightOf(moment - 18 * HOUR, moment + 18 * HOUR, site).filter((one) => one.kind !== "day") : []) {
    const last = groups[groups.length - 1];
    if (last && band.from - last[1] < 6e4) last[1] = band.to;
    else groups.push([band.from, band.to]);
  }
  return groups.find(([a, b]) => moment >= a - HOUR && moment <= b + HOUR) ?? groups.find(([a]) => a > moment) ?? null;
}

/** From an hour before sunset to an hour after sunrise, around a moment. */
export function nightSpan(site, time, rows) {
  const moment = Math.floor(time / 6e5) * 6e5;
  const mine = nightAround(site, time);
  let [from, to] = mine ? [mine[0] - HOUR, mine[1] + HOUR] : [moment - 6 * HOUR, moment + 6 * HOUR];
  for (const row of rows) {
    if (utc(row.start_utc) > from - 6 * HOUR && utc(row.start_utc) < from) from = utc(row.start_utc);
    if (utc(row.end_utc) < to + 6 * HOUR && utc(row.end_utc) > to) to = utc(row.end_utc);
  }
  return [from, to];
}

const STOPS = { weather: "b-stop", fault: "b-gone" };
/** Exposures that follow each other within this are one block, s. */
const TOGETHER_S = 300;

/** What was done: exposures of a row are one block with their number, and what held it up stands between them. @returns {any[]} */
export function blocksOf(done, rows) {
  const out = [];
  for (const piece of done) {
    const [from, to] = [utc(piece.from_utc), utc(piece.to_utc)];
    if (!(to - from > 2000)) continue;
    if (STOPS[piece.group]) {
      out.push({ from, to, cls: STOPS[piece.group], texts: [inputWords(piece.kind)] });
    } else if (piece.group === "open_shutter") {
      const row = rows.find((one) => one.object && utc(one.start_utc) <= to && utc(one.end_utc) >= from);
      const last = out[out.length - 1];
      if (last?.row === row && last.frames && from - last.to < TOGETHER_S * 1000) Object.assign(last, { to, frames: last.frames + 1 });
      else out.push({ from, to, row, frames: 1, cls: row?.status === "running" ? "b-run" : "b-done", name: words(row?.object ?? piece.kind) });
    }
  }
  return out.map((block) => (block.frames ? { ...block, texts: [`${block.name}, ${block.frames} ${block.frames > 1 ? "frames" : "frame"}`, block.name] } : block));
}

/** Width of an element, as it changes. */
export function useWidth(place, least) {
  const width = useSignal(900);
  useEffect(() => {
    const observer = new ResizeObserver(() => { if (place.current) width.value = Math.max(least, place.current.clientWidth); });
    observer.observe(place.current);
    return () => observer.disconnect();
  }, []);
  return width.value;
}

const ruler = /** @type {CanvasRenderingContext2D} */ (document.createElement("canvas").getContext("2d"));
/** Width of a text of the timeline, px. */
const widthOf = (text) => { ruler.font = "550 11px Inter, sans-serif"; return ruler.measureText(text).width; };

/** The longest of the texts for which there is room, px; else the last one, shortened; nothing where half of it does not fit. */
export function fitted(texts, room) {
  const whole = texts.find((text) => widthOf(text) <= room);
  if (whole) return whole;
  const last = texts[texts.length - 1];
  for (let n = last.length - 1; n >= Math.max(3, last.length / 2); n -= 1) if (widthOf(`${last.slice(0, n)}…`) <= room) return `${last.slice(0, n).trimEnd()}…`;
  return "";
}

/**
 * The bars of a lane and above them their texts, each in the room up to where the next bar begins.
 * @param {{ from: number, to: number, cls: string, texts: string[], title?: string }[]} bars @param {(ms: number) => number} X @param {number[]} span @param {number} y
 */
function lane(bars, X, [t0, t1], y) {
  const shown = bars.filter(({ from, to }) => to >= t0 && from <= t1).map((one) => { const x = X(Math.max(one.from, t0)); return { ...one, x, w: Math.max(1.5, X(Math.min(one.to, t1)) - x) }; }).sort((a, b) => a.x - b.x);
  const labels = shown.map(({ x, w, texts }, i) => fitted(texts, Math.min(x + w, shown[i + 1]?.x ?? Infinity) - x - 10));
  return [...shown.map(({ x, w, cls, texts, title }, i) => html`<rect key=${`b${i}`} class=${cls} x=${x.toFixed(1)} y=${y + 1} width=${w.toFixed(1)} height="18" rx="3"><title>${title ?? texts[0]}</title></rect>`),
    ...shown.map(({ x, cls }, i) => labels[i] && html`<text key=${`t${i}`} x=${x + 6} y=${y + 14} class=${/b-(done|run)/.test(cls) ? "on" : "in"}>${labels[i]}</text>`)];
}

/** Names of curves `{ points, text, cls }` in pixels, each above or below its curve where neither another name nor the line of now is in the way, or left out. */
export function named(curves, right, top, now) {
  const taken = [];
  return curves.filter(({ points }) => points.length > 1).map(({ points, text, cls }) => {
    const w = widthOf(text);
    const [from, to] = [points[0][0], points[points.length - 1][0]];
    for (const middle of [0.5, 0.25, 0.75].map((part) => from + part * (to - from)).concat(now - w / 2 - 5, now + w / 2 + 5)) {
      const x = Math.min(right - w, middle - w / 2);
      const [, near] = points.reduce((best, point) => (Math.abs(point[0] - middle) < Math.abs(best[0] - middle) ? point : best));
      for (const y of [near - 6, near + 15]) {
        if (y < top + 10 || (x < now + 3 && now < x + w + 3) || taken.some(([ax, ay, aw]) => x < ax + aw + 6 && ax < x + w + 6 && Math.abs(ay - y) < 13)) continue;
        taken.push([x, y, w]);
        return html`<text key=${text} class=${cls} x=${x.toFixed(1)} y=${y.toFixed(1)}>${text}</text>`;
      }
    }
    return null;
  });
}

/** What the looks of bars mean; `ahead` is the word for what is to come. */
export const Keys = ({ ahead = "forecast" }) => [["b-done", "exposed"], ["b-next", ahead], ["b-stop", "closed for weather"], ["b-gone", "fault, or not known"]].map(([cls, text]) =>
  html`<span class="key bar-key" key=${cls}><svg width="18" height="12" aria-hidden="true"><rect class=${cls} x="1" y="1" width="16" height="10" rx="2" /></svg>${text}</span>`);

/** In the head of a night: of when its report and its forecast are, where they are not the newest. */
export const OldNight = ({ report, plan }) => [["done", report], ["forecast", plan]].map(([what, of]) => of.data !== null && of.worth !== "fresh" && html`<span class="nw" key=${what}>${what} <${Old} of=${of} /></span>`);

export const bands = (t0, t1, site, X, y, height) => site && twilightOf(t0, t1, site).map((band) => html`<rect key=${band.from} class=${`tw-${band.kind}`} x=${X(band.from).toFixed(1)} y=${y} width=${(X(band.to) - X(band.from) + 0.6).toFixed(1)} height=${height} />`);

/**
 * `rows`: windows with status; `plan`: rows of a forecast with `runs_utc` and `altitude_curve`; `report`: of the night; `verdicts`: intervals of the
 * verdict, known up to `until` (ms); `site`; `now`; `target`: the present one, `{ name, row, ra, dec, from, to }`. Any may be absent. A phone begins with the hours around now.
 */
export function Night({ rows = [], plan = [], report = null, verdicts = [], until = null, site, now, target = null, label = "The night" }) {
  const place = useRef(null);
  const hover = useSignal(null);
  const pick = useSignal(null);
  const at = hover.value ?? pick.value;
  const W = useWidth(place, 280);
  const small = W < 560;
  const [from, to] = nightSpan(site, now, rows);
  const left = small ? 48 : 74;
  const timeOf = (clientX) => view.t0 + ((clientX - place.current.getBoundingClientRect().left - left) / (W - left - 4)) * (view.t1 - view.t0);
  const view = useTimeView(place, from, to, { timeOf, at: () => hover.peek() ?? pick.peek(), onAt: (t) => { hover.value = t >= from && t <= to ? t : null; }, onPick: (t) => { hover.value = null; pick.value = t >= from && t <= to ? t : null; }, first: innerWidth < 640 ? [now - 3 * HOUR, now + 4 * HOUR] : null });
  const { t0, t1 } = view;
  const X = (t) => left + ((t - t0) / (t1 - t0)) * (W - left - 4);
  const chart = small ? 84 : 112;
  const Y = (altitude) => TOP + chart - (Math.max(0, altitude) / 90) * chart;
  const done = report?.timeline ?? [];
  const blocks = blocksOf(done, rows);
  const lanes = ["plan", "done", ...(verdicts.length ? ["safety"] : []), ...(done.length ? ["frames"] : [])];
  const H = TOP + chart + 8 + lanes.length * LANE + FOOT;
  const laneY = (name) => TOP + chart + 8 + lanes.indexOf(name) * LANE;
  const path = (points) => points.map(([t, altitude], i) => (altitude === null ? "" : `${i && points[i - 1][1] !== null ? "L" : "M"}${X(t).toFixed(1)} ${Y(altitude).toFixed(1)}`)).join("");
  /** Its altitudes while it is up; `at(t)` is its place. */
  const track = (at, from, to) => {
    const out = [];
    for (let t = Math.max(t0, from); site && t <= Math.min(t1, to); t += 3e5) { const { alt } = altaz(at(t), t, site); out.push([t, alt > 0 ? alt : null]); }
    return out;
  };
  const luna = track(moon, t0, t1);
  const present = target ? track((t) => ofDate(target, t), target.from, target.to) : [];
  const curves = plan.filter((row) => row.altitude_curve?.length && row.row !== target?.row).map((row) => ({ name: words(row.object), points: row.altitude_curve.map((point) => [utc(point.at_utc), point.altitude_deg]).filter(([t]) => t >= t0 && t <= t1) }));
  const inPx = (points) => points.filter(([, altitude]) => altitude !== null).map(([t, altitude]) => [X(t), Y(altitude)]);
  const names = named([{ text: target?.name ?? "", points: inPx(present), cls: "h" }, { text: `Moon ${number(100 * moon(now).lit, 0)} %`, points: inPx(luna), cls: "c" }, ...curves.map(({ name, points }) => ({ text: name, points: inPx(points), cls: "c" }))], W - 6, TOP, X(now));
  const span = [t0, t1];
  const planned = rows.map((row) => ({ from: utc(row.start_utc), to: utc(row.end_utc), cls: row.status === "failed" ? "b-err" : "b-plan", texts: [words(row.object ?? row.action)], title: `${row.row + 1}. ${[row.action, row.object].filter(Boolean).join(" ")}, ${row.status}${row.detail ? `: ${row.detail}` : ""}` }));
  const ahead = plan.flatMap((row) => (row.runs_utc ?? []).filter(([, end]) => utc(end) > now).map(([a, b]) => ({ from: Math.max(now, utc(a)), to: utc(b), cls: "b-next", texts: [words(row.object ?? row.action)], title: `forecast: ${row.action} ${row.object ?? ""} ${hourMinute(a)} to ${hourMinute(b)}` })));
  const judged = verdicts.map((one) => ({ from: utc(one.from_utc), to: one.until_utc ? utc(one.until_utc) : Math.max(utc(one.from_utc), Math.min(until ?? now, now)), safe: one.verdict === "safe", cls: "b-stop", texts: ["unsafe"], title: `${one.verdict}${one.reasons?.length ? `: ${one.reasons.join("; ")}` : ""}` }));
  if (verdicts.length && until !== null && until < now) judged.push({ from: until, to: now, safe: false, cls: "b-gone", texts: ["not known"], title: `not known since ${hourMinute(until)}` });
  const marks = [...(report?.focus_runs ?? []).map((one) => [utc(one.started_utc), "F", "focus run"]), ...(report?.alerts ?? []).filter((one) => ["critical", "high", "medium"].includes(one.priority)).map((one) => [utc(one.raised_utc), SIGNS[priorityNumber(one.priority) - 1], one.cause ?? one.id])].filter(([t]) => t >= t0 && t <= t1);
  const covers = (list) => { const found = list.find((one) => at >= one.from && at <= one.to); return found && (found.title ?? found.texts?.[0]); };
  const what = at === null ? "" : [covers(blocks) ?? covers(ahead) ?? done.find((piece) => at >= utc(piece.from_utc) && at <= utc(piece.to_utc))?.kind ?? covers(planned), covers(judged.filter((one) => !one.safe))].filter(Boolean).join(" · ");
  return html`<div class="tl look" tabindex="0" role="group" aria-label=${`${label}; arrow keys move the cursor, plus and minus zoom, 0 shows all`} onKeyDown=${view.press}><div ref=${place} class="touch" data-testid="timeline" data-from=${Math.round(t0)} data-to=${Math.round(t1)}>
    <svg viewBox=${`0 0 ${W} ${H}`} height=${H} role="img" aria-label=${`${label}: ${rows.map((row) => `${row.action} ${row.object ?? ""} ${hourMinute(row.start_utc)} to ${hourMinute(row.end_utc)}, ${row.status}`).join("; ")}`}>
    ${bands(t0, t1, site, X, TOP, H - TOP - FOOT)}
    ${ticks(t0, t1, W - left).map((t) => html`<g key=${t}><path class="ax" d=${`M${X(t)} ${TOP}V${H - FOOT}`} />${X(t) > left + 14 && html`<text x=${X(t)} y=${H - 5} text-anchor="middle">${hourMinute(t)}</text>`}</g>`)}<text x=${left - 8} y=${H - 5} text-anchor="end">UTC</text>
    ${[0, 30, 60].map((altitude) => html`<text key=${altitude} x=${left - 8} y=${Y(altitude) + 4} text-anchor="end">${altitude ? `${altitude}°` : small ? "alt" : "altitude"}</text>`)}<path class="lim" d=${`M${left} ${Y(30)}H${W - 4}`} />
    <path class="ln moonln" d=${path(luna)} />${curves.map(({ name, points }) => html`<path key=${name} class="ln s4" d=${path(points)}><title>${name}</title></path>`)}
    ${target && html`<path class="ln s4" data-testid="present" d=${path(present)}><title>${target.name}</title></path><path class="ln s4 past" d=${path(present.filter(([t]) => t <= now))} />`}${names}
    ${lanes.map((name) => html`<text key=${name} x=${left - 8} y=${laneY(name) + 14} text-anchor="end">${name}</text>`)}
    ${lane(planned, X, span, laneY("plan"))}${lane([...blocks, ...ahead], X, span, laneY("done"))}
    ${judged.filter((one) => one.safe && one.to > t0 && one.from < t1).map((one, i) => html`<rect key=${`s${i}`} class="b-done" x=${X(Math.max(one.from, t0))} y=${laneY("safety") + 8} width=${Math.max(1, X(Math.min(one.to, t1)) - X(Math.max(one.from, t0)))} height="4" rx="2" />`)}${lane(judged.filter((one) => !one.safe), X, span, laneY("safety"))}
    ${done.filter((piece) => piece.group === "open_shutter" && utc(piece.from_utc) >= t0 && utc(piece.from_utc) <= t1).map((piece) => html`<path key=${piece.from_utc} class="fr" d=${`M${X(utc(piece.from_utc)).toFixed(1)} ${laneY("frames") + 5}v11`} />`)}
    ${marks.map(([t, sign, words], i) => html`<g key=${`m${i}`}><title>${`${clock(t)} ${words}`}</title><path class="mark" d=${`M${X(t)} ${TOP}V${H - FOOT}`} /><text class="h" x=${X(t)} y="17" text-anchor="middle">${sign}</text></g>`)}
    ${at !== null && at >= t0 && at <= t1 && html`<path class="cur" d=${`M${X(at)} ${TOP}V${H - FOOT}`} />`}
    ${now >= t0 && now <= t1 && html`<path class="now" d=${`M${X(now)} 6V${H - FOOT}`} /><rect class="nowflag" x=${Math.min(X(now) + 2, W - 66)} y="4" width="62" height="17" rx="4" /><text class="nowt" x=${Math.min(X(now) + 33, W - 35)} y="16.5" text-anchor="middle">now ${hourMinute(now)}</text>`}</svg></div>
    <${TimeTools} view=${view} at=${at} pick=${pick.value} what=${what} /></div>`;
}

/** One telescope of many: what was done, and what is planned. */
function Line({ id, now, draw, y }) {
  const summary = net.value.get(id);
  const entry = useTopic(`tel/${id}/observatory/schedule`)?.get(`${id}/observatory/schedule/state`);
  const rows = entry?.body.rows ?? NONE;
  const answer = useReport(id, tonight(summary));
  const report = answer.data;
  const done = useMemo(() => (report?.timeline ? blocksOf(report.timeline, rows) : null), [report, rows]);
  const silent = summary && !standing(summary).fresh;
  const ahead = rows.filter((row) => ["pending", "running", "interrupted"].includes(row.status) && utc(row.end_utc) > now).map((row) => ({ from: Math.max(now, utc(row.start_utc)), to: utc(row.end_utc), cls: silent ? "b-gone" : "b-next", texts: [silent ? "not known" : words(row.object ?? row.action)],
    title: `${row.action} ${row.object ?? ""} ${hourMinute(row.start_utc)} to ${hourMinute(row.end_utc)}` }));
  // Without a report of the archive the windows of finished rows stand for what was done.
  const past = done ? [...done] : rows.filter((row) => row.status === "finished" && row.object).map((row) => ({ from: utc(row.start_utc), to: Math.min(now, utc(row.end_utc)), cls: "b-plan", texts: [words(row.object)], title: `${row.object}, ${row.status}` }));
  const read = report && answer.worth !== "fresh" ? answeredAt(answer) : now;
  if (read < now) past.push({ from: read, to: now, cls: "b-gone", texts: ["not known"], title: `what was done is not known since ${hourMinute(read)}` });
  return html`<g data-testid="night-line" data-of=${id}>${bands(draw.t0, draw.t1, siteOf(summary), draw.X, y, 22)}${lane([...past, ...ahead], draw.X, [draw.t0, draw.t1], y + 1)}</g>`;
}
const NONE = [];

/** The night of all telescopes, one below the other: `telescopes` are their summaries; what each did is read when this comes into view. */
export function Nights({ telescopes, now }) {
  const place = useRef(null);
  const hover = useSignal(null);
  const seen = useSignal(false);
  const W = useWidth(place, 300);
  useEffect(() => {
    const observer = new IntersectionObserver(([entry]) => { if (entry.isIntersecting) seen.value = true; }, { rootMargin: "200px" });
    observer.observe(place.current);
    return () => observer.disconnect();
  }, []);
  const small = W < 560;
  const sites = new Map(telescopes.filter(siteOf).map((one) => [one.site_id, siteOf(one)]));
  const spans = [...sites.values()].map((site) => nightSpan(site, now, NONE));
  const [from, to] = spans.length ? [Math.min(...spans.map(([a]) => a)), Math.max(...spans.map(([, b]) => b))] : nightSpan(null, now, NONE);
  const left = small ? 84 : 118;
  const timeOf = (clientX) => view.t0 + ((clientX - place.current.getBoundingClientRect().left - left) / (W - left - 4)) * (view.t1 - view.t0);
  const onAt = (t) => { hover.value = t >= from && t <= to ? t : null; };
  const view = useTimeView(place, from, to, { timeOf, at: () => hover.peek(), onAt, onPick: onAt, first: innerWidth < 640 ? [now - 3 * HOUR, now + 4 * HOUR] : null });
  const { t0, t1 } = view;
  const draw = { t0, t1, X: (t) => left + ((t - t0) / (t1 - t0)) * (W - left - 4) };
  const H = telescopes.length * 26 + FOOT;
  return html`<div class="tl look" tabindex="0" role="group" aria-label="The night of all telescopes; the table says what each does. Arrow keys move the cursor, plus and minus zoom, 0 shows all." onKeyDown=${view.press}><div ref=${place} class="touch" style=${{ minHeight: `${H}px` }}><ul class="names" style=${{ width: `${left - 8}px` }}>${telescopes.map((one) => html`<li key=${one.id}><a class="cut" href=${`/t/${one.id}`}>${one.telescope_id}</a></li>`)}</ul>
    ${seen.value && html`<svg viewBox=${`0 0 ${W} ${H}`} height=${H}>${telescopes.map(({ id }, i) => html`<${Line} key=${id} id=${id} now=${now} draw=${draw} y=${i * 26} />`)}
    ${ticks(t0, t1, W - left).map((t) => html`<text key=${t} x=${draw.X(t)} y=${H - 4} text-anchor="middle">${hourMinute(t)}</text>`)}<text x="0" y=${H - 4}>UTC</text>
    ${hover.value !== null && hover.value >= t0 && hover.value <= t1 && html`<path class="cur" d=${`M${draw.X(hover.value)} 0V${H - FOOT}`} />`}${now >= t0 && now <= t1 && html`<path class="now" d=${`M${draw.X(now)} 0V${H - FOOT}`} />`}</svg>`}</div>
    <${TimeTools} view=${view} at=${hover.value} id=${null} /></div>`;
}
