// A draft over the night: each row is a bar that is dragged, or moved by the arrow keys, as a whole or by one end; below it the dry run and what is in force.
import { html, useEffect, useMemo, useRef, useSignal } from "./lib.js";
import { altaz, moon, ofDate } from "./astro.js";
import { hourMinute } from "./format.js";
import { bands, fitted, named, nightSpan, ticks, useWidth } from "./night.js";
import { Kept } from "./parts.js";
import { nameOf } from "./rowtext.js";
import { TimeTools, useTimeView } from "./timeview.js";

const MINUTE = 60e3;
const HOUR = 60 * MINUTE;
const SLIM = 10;
const TOP = 22;
const FOOT = 20;
/** Curves of more targets would hide each other. */
const MOST_CURVES = 40;
/** A pointer that moved less was a touch, px. */
const STILL_PX = 4;
const whole = (ms) => Math.round(ms / MINUTE) * MINUTE;

/** Rows in as few lanes as it takes that none covers another: the lane of each, and how many there are. */
function lanesOf(rows) {
  const ends = [];
  const lane = [];
  for (const [{ start, end }, i] of rows.map((one, i) => [one, i]).sort(([a], [b]) => a.start - b.start)) {
    const free = ends.findIndex((until) => until <= start);
    lane[i] = free < 0 ? ends.length : free;
    ends[lane[i]] = end;
  }
  return { lane, count: ends.length };
}

/** Begin and end of a row after a part of it was moved by so many ms, in whole minutes; a row lasts a minute at least. */
export function shifted({ start, end }, part, by) {
  if (part === "start") return [Math.min(whole(start + by), Math.ceil(end / MINUTE - 1) * MINUTE), end];
  if (part === "end") return [start, Math.max(whole(end + by), Math.floor(start / MINUTE + 1) * MINUTE)];
  return [whole(start + by), Math.max(whole(end + by), whole(start + by) + MINUTE)];
}

const PARTS = { both: "Line", start: "Start of line", end: "End of line" };

/**
 * `rows` and `inForce` as `rowsOf` gives them; `marked`: the worst finding of a line; `plan`: rows of a dry run; `chosen`: the row that is chosen, or null. `onChoose(row)` is told of a touch,
 * `onOpen(row)` of two or of Enter, `onMove(row, [from, to], part, isKey)` of a drag that ended and of each press of a key.
 */
export function DraftLine({ rows, marked, inForce, plan, site, now, chosen, onChoose, onOpen, onMove }) {
  const place = useRef(null);
  const hover = useSignal(null);
  const drag = useSignal(null);
  const W = useWidth(place, 280);
  const small = W < 560;
  const left = small ? 48 : 74;
  // A finger needs more than a pointer.
  const [laneH, reach] = small ? [38, 18] : [25, 12];
  const barH = laneH - 7;
  const placed = rows.filter((one) => one.end > one.start);
  const unread = rows.filter((one) => !(one.end > one.start));
  // They change with few letters.
  const times = placed.flatMap(({ start, end }) => [start, end]);
  const mine = useMemo(() => placed.map((one) => ({ start_utc: new Date(one.start).toISOString(), end_utc: new Date(one.end).toISOString() })), times);
  // A draft for another night is drawn over that one.
  const tonight = nightSpan(site, now, []);
  const moment = !placed.length || placed.some((one) => one.start < tonight[1] && one.end > tonight[0]) ? now : Math.min(...placed.map((one) => one.start));
  const [from, to] = nightSpan(site, moment, mine);
  const timeOf = (clientX) => view.t0 + ((clientX - place.current.getBoundingClientRect().left - left) / (W - left - 4)) * (view.t1 - view.t0);
  const view = useTimeView(place, from, to, { timeOf, at: () => hover.peek(), onAt: (t) => { hover.value = t >= from && t <= to ? t : null; }, onPick: (t) => { hover.value = t >= from && t <= to ? t : null; }, own: true, first: innerWidth < 640 ? [moment - HOUR, moment + 5 * HOUR] : null });
  const { t0, t1 } = view;
  const X = (t) => left + ((t - t0) / (t1 - t0)) * (W - left - 4);
  const chart = small ? 84 : 112;
  const Y = (altitude) => TOP + chart - (Math.max(0, altitude) / 90) * chart;
  const { lane, count } = useMemo(() => lanesOf(placed), times);
  const before = inForce.filter((one) => one.end > one.start);
  const old = useMemo(() => lanesOf(before), [inForce]);
  const yDraft = TOP + chart + 8;
  const yPlan = yDraft + Math.max(1, count) * laneH;
  const yOld = yPlan + (plan ? 25 : 0) + 4;
  const H = yOld + Math.max(2, old.count) * SLIM + 4 + FOOT;
  const path = (points) => points.map(([t, altitude], i) => (altitude > 0 ? `${i && points[i - 1][1] > 0 ? "L" : "M"}${X(t).toFixed(1)} ${Y(altitude).toFixed(1)}` : "")).join("");
  const track = (a, b, at) => { const out = []; if (site) for (let t = a; t <= b; t += 6e5) out.push([t, altaz(at(t), t, site).alt]); return out; };
  const hasPlace = ({ row }) => Number.isFinite(row.action_value?.ra) && Number.isFinite(row.action_value?.dec);
  const now_ = (one) => (drag.value?.key === one.number && drag.value.moved ? drag.value.span : [one.start, one.end]);
  const words = (one) => nameOf(one.row).replace(/^object (?=.)/, "").replaceAll("_", " ");
  const told = ([a, b]) => `${hourMinute(a)} to ${hourMinute(b)}`;

  const targets = placed.filter(hasPlace).slice(0, MOST_CURVES).map((one) => { const [a, b] = now_(one); return { name: words(one), ra: one.row.action_value.ra, dec: one.row.action_value.dec, a, b, isChosen: one.number === chosen?.number }; });
  const altitudes = () => {
    const curves = targets.map(({ name, ra, dec, a, b, isChosen }) => { const at = (t) => ofDate({ ra, dec }, t); return { name, isChosen, whole: track(t0, t1, at), own: track(Math.max(t0, a), Math.min(t1, b), at) }; });
    const names = named(curves.map(({ name, isChosen, own }) => ({ text: name, points: own.filter(([, altitude]) => altitude > 0).map(([t, altitude]) => [X(t), Y(altitude)]), cls: isChosen ? "h" : "c" })).sort((a, b) => (a.cls > b.cls ? -1 : 1)).filter((one, i, all) => all.findIndex(({ text }) => text === one.text) === i), W - 6, TOP, X(now));
    return html`<path class="ln moonln" d=${path(track(t0, t1, moon))} />
      ${curves.map(({ name, isChosen, whole: all, own }, i) => html`<g key=${`c${i}`}><path class="ln s4 ghost" d=${path(all)} /><path class=${`ln s4 ${isChosen ? "thick" : ""}`} d=${path(own)}><title>${name}</title></path></g>`)}${names}`;
  };

  // A row that is chosen elsewhere comes into view.
  useEffect(() => {
    if (chosen && view.zoomed && (chosen.start > t1 || chosen.end < t0)) view.move((chosen.start + chosen.end - t0 - t1) / 2);
  }, [chosen?.number, chosen?.start]);

  // One listener serves all bars: those of hundreds of rows would be put on anew with each letter.
  const barOf = (event) => event.target.closest('[data-testid="draft-bar"]');
  const rowOf = (event) => rows.find((one) => one.number === Number(barOf(event).dataset.row));
  const down = (event) => {
    if (event.button > 0 || drag.peek()) return;
    event.stopPropagation();
    barOf(event).setPointerCapture?.(event.pointerId);
    const one = rowOf(event);
    const part = event.target.dataset.part ?? "both";
    drag.value = { key: one.number, pointer: event.pointerId, part, x: event.clientX, perPx: (t1 - t0) / (W - left - 4), span: [one.start, one.end], moved: false };
    onChoose(one);
  };
  const move = (event) => {
    const now = drag.peek();
    if (now?.pointer !== event.pointerId) return;
    const px = event.clientX - now.x;
    if (now.moved || Math.abs(px) > STILL_PX) drag.value = { ...now, moved: true, span: shifted(rowOf(event), now.part, px * now.perPx) };
  };
  const up = (event) => {
    const now = drag.peek();
    if (now?.pointer !== event.pointerId) return;
    drag.value = null;
    if (event.type === "pointerup" && now.moved) onMove(rowOf(event), now.span, now.part, false);
  };
  const press = (event) => {
    const one = rowOf(event);
    const part = event.target.dataset.part ?? "both";
    if (event.key === "Escape") drag.value = null;
    if (event.key === "Enter") onOpen(one);
    const side = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!side || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    onMove(one, shifted(one, part, side * (event.shiftKey ? 10 : 1) * MINUTE), part, true);
  };
  const isWrong = (one) => Array.from({ length: one.lines }, (_, i) => marked.get(one.line + i)).includes("error");
  const slider = (one, part, at, text, wrong) => ({ tabindex: 0, role: "slider", "aria-label": `${PARTS[part]} ${one.line}, ${nameOf(one.row)}${wrong ? ", has an error" : ""}`, "aria-orientation": "horizontal", "aria-valuemin": Math.round(from / MINUTE), "aria-valuemax": Math.round(to / MINUTE), "aria-valuenow": Math.round(at / MINUTE), "aria-valuetext": text });

  const bar = (one, i) => {
    const [a, b] = now_(one);
    if (b < t0 || a > t1) return null;
    const isChosen = chosen?.number === one.number;
    const wrong = isWrong(one);
    const y = yDraft + lane[i] * laneH;
    const draw = () => {
      const x = X(Math.max(a, t0));
      const w = Math.max(3, X(Math.min(b, t1)) - x);
      const out = isChosen ? reach : 0;
      const inner = Math.min(10, w / 4);
      const text = fitted([words(one)], w - 16);
      const end = (part, t, at) => t >= t0 && t <= t1 && html`<g key=${part} class="grip" data-part=${part} ...${isChosen ? slider(one, part, t, hourMinute(t), wrong) : {}}><rect class="reach" data-part=${part} x=${part === "start" ? at - out : at - inner} y=${y - (isChosen ? 3 : 0)} width=${out + inner} height=${barH + (isChosen ? 8 : 2)} />${isChosen && html`<rect class="knob" data-part=${part} x=${part === "start" ? at - 3 : at - 1} y=${y + 4} width="4" height=${barH - 6} rx="2" />`}</g>`;
      return html`<g class="draft-bar" data-testid="draft-bar" data-row=${one.number} data-from=${new Date(a).toISOString()} data-to=${new Date(b).toISOString()} data-chosen=${isChosen}>
        <title>${`line ${one.line}: ${nameOf(one.row)}, ${told([a, b])}`}</title><g class="body" ...${slider(one, "both", a, told([a, b]), wrong)}><rect class=${isChosen ? "b-run" : wrong ? "b-err" : "b-plan"} x=${x.toFixed(1)} y=${y + 1} width=${w.toFixed(1)} height=${barH} rx="3" />${text && html`<text x=${x + 8} y=${y + barH / 2 + 5} class=${isChosen ? "on" : "in"}>${text}</text>`}</g>
        ${end("start", a, X(a))}${end("end", b, X(b))}</g>`;
    };
    return html`<${Kept} key=${`b${one.number}`} parts=${[one.line, nameOf(one.row), a, b, isChosen, wrong, y, t0, t1, from, to, W]} draw=${draw} />`;
  };
  const dragged = drag.value?.moved && placed.find((one) => one.number === drag.value.key);
  const at = dragged ? drag.value.span[drag.value.part === "end" ? 1 : 0] : hover.value;
  const under = at === null ? [] : placed.filter((one) => at >= one.start && at <= one.end);
  const runs = (plan ?? []).flatMap((row) => (row.runs_utc ?? []).map(([a, b]) => ({ a: Date.parse(a), b: Date.parse(b), name: [row.action, row.object].filter(Boolean).join(" ") })));
  const piece = (cls, a, b, y, height, title, key) => b > t0 && a < t1 && html`<rect key=${key} class=${cls} x=${X(Math.max(a, t0)).toFixed(1)} y=${y} width=${Math.max(1.5, X(Math.min(b, t1)) - X(Math.max(a, t0))).toFixed(1)} height=${height} rx="2"><title>${title}</title></rect>`;
  return html`<div class="tl look" tabindex="0" role="group" aria-label="The draft over the night; arrow keys move the cursor, and a row that has the focus; plus and minus zoom, 0 shows all" onKeyDown=${view.press}><div ref=${place} class="touch" data-testid="draft-line" data-from=${Math.round(t0)} data-to=${Math.round(t1)}>
    <svg viewBox=${`0 0 ${W} ${H}`} height=${H} role="group" aria-label="Rows of the draft">
    ${bands(t0, t1, site, X, TOP, H - TOP - FOOT)}
    ${ticks(t0, t1, W - left).map((t) => html`<g key=${`t${t}`}><path class="ax" d=${`M${X(t)} ${TOP}V${H - FOOT}`} /><text x=${X(t)} y=${H - 5} text-anchor="middle">${hourMinute(t)}</text></g>`)}<text x=${left - 8} y=${H - 5} text-anchor="end">UTC</text>
    ${[0, 30, 60].map((altitude) => html`<text key=${`a${altitude}`} x=${left - 8} y=${Y(altitude) + 4} text-anchor="end">${altitude ? `${altitude}°` : small ? "alt" : "altitude"}</text>`)}<path class="lim" d=${`M${left} ${Y(30)}H${W - 4}`} />
    <${Kept} parts=${[t0, t1, W, site, Math.round(X(now)), ...targets.flatMap(Object.values)]} draw=${altitudes} />
    <text x=${left - 8} y=${yDraft + 14} text-anchor="end">draft</text><g onPointerDown=${down} onPointerMove=${move} onPointerUp=${up} onPointerCancel=${up} onDblClick=${(event) => { event.stopPropagation(); onOpen(rowOf(event)); }} onFocusIn=${(event) => { if (event.target.matches(".body")) onChoose(rowOf(event)); }} onKeyDown=${press}>${placed.map(bar)}</g>
    ${plan && html`<text x=${left - 8} y=${yPlan + 14} text-anchor="end">dry run</text>${runs.map((one, i) => piece("b-next", one.a, one.b, yPlan + 1, 18, `${one.name}, ${hourMinute(one.a)} to ${hourMinute(one.b)}`, `p${i}`))}`}
    <text x=${left - 8} y=${yOld + 12} text-anchor="end">in force</text><${Kept} parts=${[inForce, t0, t1, W, yOld]} draw=${() => before.map((one, i) => piece("b-next", one.start, one.end, yOld + old.lane[i] * SLIM, SLIM - 3, `in force: ${nameOf(one.row)}, ${hourMinute(one.start)} to ${hourMinute(one.end)}`, `o${i}`))} />
    <g pointer-events="none">${at !== null && at >= t0 && at <= t1 && html`<path class="cur" d=${`M${X(at)} ${TOP}V${H - FOOT}`} />`}
    ${now >= t0 && now <= t1 && html`<path class="now" d=${`M${X(now)} 6V${H - FOOT}`} /><rect class="nowflag" x=${Math.min(X(now) + 2, W - 66)} y="4" width="62" height="17" rx="4" /><text class="nowt" x=${Math.min(X(now) + 33, W - 35)} y="16.5" text-anchor="middle">now ${hourMinute(now)}</text>`}</g></svg></div>
    <${TimeTools} view=${view} at=${at} id=${null} hint="Drag a bar or its ends, or use the arrow keys; elsewhere drag to look around." what=${dragged ? `${words(dragged)}: ${told(now_(dragged))}` : under.map((one) => `${words(one)} ${told(now_(one))}`).join(" · ")} />
    ${unread.length > 0 && html`<p class="why">Without a bar: ${unread.slice(0, 5).map((one) => `line ${one.line}`).join(", ")}${unread.length > 5 ? ` and ${unread.length - 5} more` : ""}, whose times are none, or the wrong way round.</p>`}</div>`;
}
