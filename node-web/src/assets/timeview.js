// Looking around in time, the same on the timeline and on every chart: dragged sideways, zoomed by two fingers, by the wheel with Ctrl (or with
// the focus there) and by keys, with buttons for those who do none of it; and from any moment to the log lines of that minute.
import { effect, html, signal, useEffect, useRef, useSignal } from "./lib.js";
import { clockOn } from "./format.js";
import { Icon } from "./parts.js";
import { go, route, withQuery } from "./route.js";

const STEP = 1.6;
/** A pointer that moved less was a touch, not a drag, px. */
const STILL_PX = 5;
/** A view that has not moved for so long stands in the address, ms: browsers take only so many changes of it. */
const REST_MS = 300;

/** The part of the time that the charts of this page show, ms: null is all of it, undefined what each begins with. The address has it in whole seconds. */
const chosen = signal(undefined);
let named = "";
let naming = 0;

effect(() => {
  const asked = ["from", "to"].map((name) => route.value.query.get(name));
  const name = [location.pathname, ...asked].join();
  if (name === named) return;
  named = name;
  clearTimeout(naming);
  const [from, to] = asked.map((utc) => Date.parse(utc));
  chosen.value = to > from ? [from, to] : undefined;
});

function choose(view) {
  chosen.value = view;
  clearTimeout(naming);
  naming = setTimeout(() => {
    const [from = null, to = null] = (view ?? []).map((t) => `${new Date(t).toISOString().slice(0, 19)}Z`);
    named = [location.pathname, from, to].join();
    go(withQuery({ from, to }), { replace: true });
  }, REST_MS);
}

/**
 * A part of the time from `from` to `to` (ms). `timeOf(clientX)` gives the time below a pointer; `onAt(ms)` is told the moment
 * below the mouse or of the keys, `onPick(ms)` the one that was touched or that keys chose. All views of a page are one, which stands in its address, but for those that are `own`.
 * Gives `{ t0, t1, zoomed, zoom(factor, around), move(ms), whole(), press }`: `press` is for keys of the element that is looked at.
 */
export function useTimeView(place, from, to, { timeOf, at, onAt, onPick, first = null, least = 60e3, own = false }) {
  const mine = useSignal(first);
  const begin = useRef(first);
  const latest = useRef(null);
  const view = own ? mine.value : chosen.value === undefined ? begin.current : chosen.value;
  const set = own ? (next) => { mine.value = next; } : choose;
  // An address may name a time that is no longer here.
  const part = view && view[0] < to && view[1] > from ? inside(view, from, to) : null;
  const [t0, t1] = part ?? [from, to];
  const show = (a, b) => {
    const span = Math.min(to - from, Math.max(least, b - a));
    const middle = (a + b) / 2;
    const next = inside([middle - span / 2, middle + span / 2], from, to);
    set(next[1] - next[0] >= to - from ? null : next);
  };
  const zoom = (factor, around = at() ?? (t0 + t1) / 2) => {
    const point = Math.max(t0, Math.min(t1, around));
    const span = Math.min(to - from, Math.max(least, (t1 - t0) / factor));
    const start = point - ((point - t0) / (t1 - t0)) * span;
    show(start, start + span);
  };
  const move = (ms) => { if (part) show(t0 + ms, t1 + ms); };
  const whole = () => set(null);
  latest.current = { t0, t1, zoom, show, timeOf, onAt, onPick };

  useEffect(() => {
    const element = place.current;
    const fingers = new Map();
    let begun = null;
    let dragged = false;
    const down = (event) => {
      if (event.button > 0 || event.target.closest("a, button")) return;
      fingers.set(event.pointerId, event.clientX);
      begin();
      if (fingers.size === 1) dragged = false;
    };
    /** From here the fingers that are down drag and zoom. */
    const begin = () => {
      const { t0: a, t1: b, timeOf: time } = latest.current;
      const middle = middleOf(fingers);
      begun = { t0: a, t1: b, apart: apart(fingers), middle, around: time(middle), perPx: (time(middle + 100) - time(middle)) / 100 };
    };
    const moved = (event) => {
      const now = latest.current;
      if (!fingers.has(event.pointerId)) {
        if (event.pointerType === "mouse") now.onAt(now.timeOf(event.clientX));
        return;
      }
      fingers.set(event.pointerId, event.clientX);
      if (fingers.size > 1) {
        dragged = true;
        const factor = Math.max(0.05, apart(fingers) / (begun.apart || 1));
        const span = (begun.t1 - begun.t0) / factor;
        const start = begun.around - ((begun.around - begun.t0) / (begun.t1 - begun.t0)) * span - (middleOf(fingers) - begun.middle) * (begun.perPx / factor);
        now.show(start, start + span);
      } else if (dragged || Math.abs(event.clientX - begun.middle) > STILL_PX) {
        if (!dragged) element.setPointerCapture?.(event.pointerId);
        dragged = true;
        const by = (begun.middle - event.clientX) * begun.perPx;
        now.show(begun.t0 + by, begun.t1 + by);
      }
    };
    const up = (event) => {
      const was = fingers.delete(event.pointerId);
      if (was && event.type === "pointerup" && !dragged) latest.current.onPick(latest.current.timeOf(event.clientX));
      if (fingers.size) begin();
    };
    const wheel = (event) => {
      if (!event.ctrlKey && !event.metaKey && !element.closest(".look").matches(":focus-within")) return;
      event.preventDefault();
      latest.current.zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2, latest.current.timeOf(event.clientX));
    };
    const twice = (event) => { if (!event.target.closest("a, button")) latest.current.zoom(3, latest.current.timeOf(event.clientX)); };
    const away = (event) => { if (event.pointerType === "mouse" && !fingers.size) latest.current.onAt(null); };
    const heard = { pointerdown: down, pointermove: moved, pointerup: up, pointercancel: up, pointerleave: away, wheel, dblclick: twice };
    for (const [name, hear] of Object.entries(heard)) element.addEventListener(name, hear, name === "wheel" ? { passive: false } : undefined);
    return () => { for (const [name, hear] of Object.entries(heard)) element.removeEventListener(name, hear); };
  }, []);

  /** Arrow keys move the cursor, with Shift the view; + and - zoom, 0 shows the whole. */
  const press = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const side = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (side && event.shiftKey) move((side * (t1 - t0)) / 10);
    else if (side) {
      const next = Math.max(from, Math.min(to, (at() ?? Math.min(t1, Math.max(t0, (t0 + t1) / 2))) + (side * (t1 - t0)) / 100));
      if (next < t0 || next > t1) move(side * (t1 - t0) * 0.5);
      onPick(next);
    } else if (event.key === "+" || event.key === "=") zoom(STEP);
    else if (event.key === "-") zoom(1 / STEP);
    else if (event.key === "0") whole();
    else return;
    event.preventDefault();
  };
  return { t0, t1, zoomed: part !== null, zoom, move, whole, press };
}

const apart = (fingers) => { const [a, b] = [...fingers.values()]; return b === undefined ? 0 : Math.abs(a - b); };
const middleOf = (fingers) => [...fingers.values()].reduce((sum, x) => sum + x, 0) / fingers.size;

/** A part of the time that stays between the two ends. */
function inside([a, b], from, to) {
  const span = Math.min(b - a, to - from);
  const start = Math.max(from, Math.min(to - span, a));
  return [start, start + span];
}

/** Buttons below what is looked at, the moment of the cursor in words, and the way to its log; `end` is one more, and `hint` stands there without a moment. */
export function TimeTools({ view, at, pick = null, what = "", id = route.value.id, end = null, hint = `Drag to look around; ${id ? "touch a moment for its log" : "touch a name to go there"}.` }) {
  return html`<div class="time-tools"><span class="seg" role="group" aria-label="Time shown"><button type="button" aria-label="Show more time" disabled=${!view.zoomed} onClick=${() => view.zoom(1 / STEP)}>−</button><button type="button" aria-label="Show less time" onClick=${() => view.zoom(STEP)}>+</button><button type="button" disabled=${!view.zoomed} onClick=${view.whole}>All</button></span>
    <span class="m grow cut">${at ? html`<b>${clockOn(view.t1 - view.t0, at)}</b> ${what}` : html`<span class="desk">${hint}</span>`}</span>${pick && id && html`<a class="btn sm soft" data-testid="log-here" href=${`/t/${id}/log?at=${encodeURIComponent(new Date(Math.round(pick)).toISOString())}`} aria-label=${`Log of the minute around ${clockOn(view.t1 - view.t0, pick)}`}><${Icon} name="log" /><span>Log of ${clockOn(view.t1 - view.t0, pick)}</span></a>`}${end}</div>`;
}
