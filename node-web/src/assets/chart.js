// Charts over time: panels one below the other with one cursor (uPlot). The far side of a limit is hatched, and no line crosses a gap.
import { html, signal, useEffect, useMemo, useRef, useSignal } from "./lib.js";
import { clockOn, labels, number, tickOn } from "./format.js";
import { useNumbers } from "./numbers.js";
import { TimeTools, useTimeView } from "./timeview.js";

/** @type {any} uPlot, once it has come: a page is there before its charts. */
const library = signal(null);
const missing = signal(false);
let fetching = false;
function fetchLibrary() {
  if (fetching) return;
  fetching = true;
  import("./vendor/uplot.js").then((found) => { library.value = found.default; }, (error) => {
    console.warn("the charts' library has not come", error);
    missing.value = true;
  });
}
const LEFT = 56;
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const SERIES = ["--s1", "--s2", "--s3", "--s4"];
const DASH = { "--s2": [6, 3], "--s3": [2, 3] };

/** Lines of 45 degrees in a rectangle. */
function hatch(ctx, x, y, w, h, colour, every = 7) {
  if (w <= 0 || h <= 0) return;
  ctx.save();
  ctx.beginPath();
  ctx.rect(x, y, w, h);
  ctx.clip();
  ctx.strokeStyle = colour;
  ctx.lineWidth = 1;
  ctx.beginPath();
  for (let at = x - h; at < x + w; at += every) {
    ctx.moveTo(at, y + h);
    ctx.lineTo(at + h, y);
  }
  ctx.stroke();
  ctx.restore();
}

/** Points of several series, `[ms, value]` each, as uPlot's columns; a gap is a `null`. */
export function columns(series) {
  const times = [...new Set(series.flatMap((one) => one.points.map(([t]) => t)))].sort((a, b) => a - b);
  const at = new Map(times.map((t, i) => [t, i]));
  return [times.map((t) => t / 1000), ...series.map((one) => {
    const column = new Array(times.length).fill(undefined);
    for (const [t, value] of one.points) column[at.get(t)] = Number.isFinite(value) ? value : null;
    return column;
  })];
}

/** What panels show between two times, as heads and rows of a table; the newest first. */
function tableOf(panels, t0, t1) {
  const all = panels.flatMap((panel) => panel.series.map((one) => ({ ...one, panel })));
  const [times, ...values] = columns(all);
  const heads = all.map(({ panel, head, name }) => ({ name: head ?? [panel.name, name].filter(Boolean).join(" "), unit: panel.unit, digits: panel.digits ?? 1 }));
  const rows = times.map((t, i) => [Math.round(t * 1000), ...values.map((column) => column[i])]).filter(([t, ...row]) => t >= t0 && t <= t1 && row.some(Number.isFinite));
  return { heads: [{ name: "Time", unit: "UTC", isTime: true }, ...heads], rows: rows.reverse() };
}

/** Points and gaps of the API's `Series` as `[ms, value]`, with `null` in each gap. `pick` is `min`, `mean` or `max`. */
export function pointsOf(series, pick = "mean") {
  const points = (series?.points ?? []).map((point) => [Date.parse(point.at_utc), typeof point[pick] === "number" ? point[pick] : point.mean]);
  for (const gap of series?.gaps ?? []) points.push([Date.parse(gap.from_utc) + 1, null]);
  return points.sort((a, b) => a[0] - b[0]);
}

/** The points with a gap where much longer than usual nothing came: no line is drawn over a gap. */
export function broken(points) {
  const steps = points.slice(1).map(([t], i) => t - points[i][0]).sort((a, b) => a - b);
  const longest = 6 * (steps[Math.floor(steps.length / 2)] ?? 0);
  return points.flatMap((point, i) => (i && point[0] - points[i - 1][0] > longest ? [[points[i - 1][0] + 1, null], point] : [point]));
}

/** The scale of a panel: all its values, and its limits, so that no limit lies outside. */
function range(panel) {
  let [low, high] = [Infinity, -Infinity];
  for (const one of panel.series) {
    for (const [, value] of one.points) {
      if (!Number.isFinite(value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  for (const limit of panel.limits ?? []) {
    low = Math.min(low, limit.v);
    high = Math.max(high, limit.v);
  }
  if (panel.zero) low = Math.min(low, 0);
  if (!Number.isFinite(low)) return [0, 1];
  const air = (high - low || Math.abs(high) || 1) * 0.08;
  return [panel.zero && low === 0 ? 0 : low - air, high + air];
}

function draw(plot, panel, shared) {
  const { ctx, bbox } = plot;
  const y = (value) => plot.valToPos(value, "y", true);
  const x = (ms) => plot.valToPos(ms / 1000, "x", true);
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  for (const [from, to] of panel.unsafe ?? shared.unsafe ?? []) {
    ctx.fillStyle = css("--raised");
    ctx.fillRect(x(from), bbox.top, x(to) - x(from), bbox.height);
    hatch(ctx, x(from), bbox.top + bbox.height - 5, x(to) - x(from), 5, css("--ink-3"), 4);
  }
  for (const limit of panel.limits ?? []) {
    const at = y(limit.v);
    const [top, height] = limit.side === "below" ? [at, bbox.top + bbox.height - at] : [bbox.top, at - bbox.top];
    hatch(ctx, bbox.left, top, bbox.width, height, css("--line"));
    ctx.strokeStyle = css("--ink-2");
    ctx.setLineDash([6, 3]);
    ctx.beginPath();
    ctx.moveTo(bbox.left, at);
    ctx.lineTo(bbox.left + bbox.width, at);
    ctx.stroke();
    ctx.setLineDash([]);
    if (limit.text) {
      ctx.fillStyle = css("--ink-2");
      ctx.textAlign = "left";
      ctx.textBaseline = "alphabetic";
      ctx.font = `${11 * devicePixelRatio}px Inter, sans-serif`;
      ctx.fillText(limit.text, bbox.left + 8 * devicePixelRatio, limit.side === "below" && bbox.top + bbox.height - at > 18 * devicePixelRatio || limit.side !== "below" && at - bbox.top < 18 * devicePixelRatio ? at + 14 * devicePixelRatio : at - 5 * devicePixelRatio);
    }
  }
  for (const [t, colour] of [...(shared.marks ?? []).map((mark) => [mark.t, "--ink-3"]), ...(shared.now ? [[shared.now, "--ink"]] : [])]) {
    ctx.strokeStyle = css(colour);
    ctx.beginPath();
    ctx.moveTo(x(t), bbox.top);
    ctx.lineTo(x(t), bbox.top + bbox.height);
    ctx.stroke();
  }
  ctx.restore();
}

/** The second colour is also another form, for who sees no colours: hollow dots, broken lines. */
const isSecond = (one) => one.colour === "--s2";
/** The form of a series before its name. */
const keyOf = (one) => (one.kind === "dots" ? (isSecond(one) ? "ring" : "dot") : isSecond(one) ? "dash" : "");

function seriesOf(one, i) {
  const name = one.colour ?? SERIES[i % SERIES.length];
  const colour = () => css(name);
  if (one.kind === "dots") return { label: one.name, stroke: colour, paths: () => null, points: { show: true, size: one.size ?? 5, stroke: colour, fill: isSecond(one) ? () => css("--well") : colour, width: isSecond(one) ? 1.3 : 0 } };
  if (one.kind === "bars") return { label: one.name, stroke: colour, fill: colour, paths: library.peek().paths.bars({ size: [0.6, 6] }), points: { show: false } };
  return { label: one.name, stroke: colour, width: one.width ?? 1.6, dash: one.dash ?? (isSecond(one) || document.documentElement.dataset.theme === "night" ? DASH[name] : undefined), points: { show: one.points.length < 3 }, spanGaps: false,
    ...(one.stepped && { paths: library.peek().paths.stepped({ align: 1 }) }) };
}

function options(panel, shared, width, last, onAt) {
  const ink = () => css("--ink-3");
  const axis = { stroke: ink, grid: { stroke: () => css("--line"), width: 1 }, ticks: { show: false }, font: "11px Inter, sans-serif" };
  return {
    width, height: panel.height + (last ? 26 : 0), padding: [6, 18, last ? 0 : 4, 0], legend: { show: false },
    cursor: { sync: { key: shared.key, setSeries: false }, y: false, drag: { x: false, y: false, setScale: false }, points: { size: 7 } },
    scales: { x: { time: true, range: () => shared.view().map((t) => t / 1000) }, y: { range: panel.range ?? range(panel) } },
    axes: [{ ...axis, show: true, size: last ? 26 : 0, values: (_, ticks) => { const [from, to] = shared.view(); return ticks.map((t) => (last ? tickOn(to - from, t * 1000) : "")); } },
      { ...axis, size: LEFT, space: 22, values: (_, ticks) => labels(ticks) }],
    tzDate: (t) => new Date(new Date(t * 1000).toLocaleString("en-US", { timeZone: "UTC" })),
    series: [{}, ...panel.series.map(seriesOf)],
    bands: panel.bands,
    hooks: {
      drawAxes: [(plot) => draw(plot, panel, shared)],
      setCursor: [(plot) => onAt(plot.cursor.left < 0 ? null : plot.posToVal(plot.cursor.left, "x") * 1000)],
    },
  };
}

/** A panel in words: its newest values, its limits, the least and the most. */
function inWords({ name, unit = "", digits = 1, limits = [], series }) {
  const say = (value) => `${number(value, digits)} ${unit}`.trim();
  const known = series.map((one) => one.points.map(([, value]) => value).filter(Number.isFinite));
  const all = known.flat();
  if (!all.length) return `${name} not known`;
  const newest = series.map((one, i) => (one.quiet || !known[i].length ? "" : `${one.name} ${say(known[i][known[i].length - 1])}`.trim())).filter(Boolean);
  return [`${name} ${newest.join(", ")}`, ...limits.map((limit) => `limit ${say(limit.v)}`), `from ${say(Math.min(...all))} to ${say(Math.max(...all))}`].join(", ").trim();
}

/** The value of a series nearest to a time. */
function nearest(points, t) {
  let found = null;
  for (const point of points) if (Number.isFinite(point[1]) && (!found || Math.abs(point[0] - t) < Math.abs(found[0] - t))) found = point;
  return found;
}

let charts = 0;

/**
 * Panels over one time axis. `panels`: `{ name, unit, digits, height, zero, series: [{ name, head, points, colour, kind, dash }], limits: [{ v, side, text }] }`; `unsafe`: times in
 * which the dome had to be closed; `marks`: `{ t, text }`; `now`; `onAt(ms)` follows the cursor, also by the arrow keys. `plain`: small, without tools below it.
 * `head`: what a series is called in the table, where its panel and its name do not say it well.
 */
export function Chart({ panels, t0, t1, unsafe, marks, now, onAt, label, plain = false }) {
  const place = useRef(null);
  const plots = useRef([]);
  const key = useRef(`chart${charts += 1}`);
  const at = useSignal(null);
  const pick = useSignal(null);
  const theme = useSignal(document.documentElement.dataset.theme);
  const point = (t) => {
    const [plot] = plots.current;
    if (plot) plot.setCursor({ left: plot.valToPos(t / 1000, "x"), top: 10 });
    at.value = t;
    onAt?.(t);
  };
  // The mouse is followed by uPlot itself; touch and keys point here.
  const over = () => place.current.querySelector(".u-over")?.getBoundingClientRect() ?? { left: 0, width: 1 };
  const timeOf = (clientX) => { const { left, width } = over(); return view.t0 + ((clientX - left) / width) * (view.t1 - view.t0); };
  const follow = useRef((_) => {});
  const view = useTimeView(place, t0, t1, { own: plain, timeOf, at: () => at.peek(), onAt: () => {}, onPick: (t) => { pick.value = Math.max(t0, Math.min(t1, t)); follow.current(pick.value); } });
  const shown = useRef([t0, t1]);
  shown.current = [view.t0, view.t1];
  useEffect(() => {
    const observer = new MutationObserver(() => { theme.value = document.documentElement.dataset.theme; });
    observer.observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    return () => observer.disconnect();
  }, []);
  const Plot = library.value;
  const shape = JSON.stringify([Boolean(Plot), theme.value, t0, t1, now && Math.round(now / 60000), unsafe, marks, panels.map((panel) => [panel.name, panel.limits, panel.series.map((one) => [one.name, one.points.length, one.points[0], one.points[one.points.length - 1]])])]);
  useEffect(() => {
    if (!Plot) return void fetchLibrary();
    const element = place.current;
    let making = false;
    const moved = (t) => {
      if (making || t === at.peek()) return;
      // The mouse is away: the cursor goes back to the moment that was chosen.
      if (t === null && pick.peek() !== null) return void queueMicrotask(() => follow.current(pick.peek()));
      at.value = t;
      onAt?.(t);
    };
    const shared = { key: key.current, unsafe, marks, now, view: () => shown.current };
    const make = () => {
      making = true;
      plots.current.forEach((plot) => plot.destroy());
      const width = Math.max(plain ? 120 : 200, element.clientWidth);
      plots.current = panels.map((panel, i) => new Plot(options({ height: 120, ...panel }, shared, width, i === panels.length - 1, moved), columns(panel.series), element.querySelectorAll(".plot")[i]));
      making = false;
      // The cursor stays where it was.
      const [first] = plots.current;
      if (first && at.peek() !== null) first.setCursor({ left: first.valToPos(at.peek() / 1000, "x"), top: 10 });
    };
    make();
    let width = element.clientWidth;
    const resized = new ResizeObserver(() => {
      if (element.clientWidth === width) return;
      width = element.clientWidth;
      make();
    });
    resized.observe(element);
    return () => {
      resized.disconnect();
      plots.current.forEach((plot) => plot.destroy());
      plots.current = [];
    };
  }, [shape]);
  useEffect(() => {
    for (const plot of plots.current) plot.setScale("x", { min: view.t0 / 1000, max: view.t1 / 1000 });
  }, [view.t0, view.t1]);
  follow.current = point;
  const press = (event) => {
    // The first step begins at the newest value.
    if (at.peek() === null && /^Arrow(Left|Right)$/.test(event.key) && !event.shiftKey) at.value = Math.min(now ?? view.t1, view.t1);
    view.press(event);
  };
  const told = label ?? panels.map((panel) => panel.name).join(", ");
  const summary = useMemo(() => panels.map(inWords).join("; "), [shape]);
  const numbers = useNumbers(told, `${shape} ${view.t0} ${view.t1}`, () => tableOf(panels, view.t0, view.t1));
  return html`<div class=${`chart live-chart look ${plain ? "plain" : ""}`} data-testid="chart" data-from=${Math.round(view.t0)} data-to=${Math.round(view.t1)} tabindex="0" role="group" aria-label=${`${label ?? `Chart of ${told} over time; arrow keys move the cursor, plus and minus zoom, 0 shows all`}. ${summary}`} onKeyDown=${press}><div class="touch" ref=${place}>
    ${panels.map((panel) => html`<div class="panel" key=${panel.name}><div class="row between read"><span class="m">${panel.name}</span><span>${panel.series.filter((one) => !one.quiet).map((one) => {
      const found = nearest(one.points, at.value ?? now ?? t1);
      return html`<span class="nw" key=${one.name}>${one.name && html`<span class=${`m key ${keyOf(one)}`} style=${{ "--c": `var(${one.colour})` }}>${one.name}</span> `}<b>${found ? number(found[1], panel.digits ?? 1) : "—"}</b> </span>`;
    })}<span class="m">${panel.unit ?? ""}${at.value ? ` at ${clockOn(view.t1 - view.t0, at.value)}` : ""}</span></span></div><div class="plot"></div></div>`)}</div>
    ${missing.value && html`<p class="m">The server did not send what draws charts; load the page again.</p>`}
    ${marks?.length > 0 && !plain && html`<p class="tagline">${marks.map((mark) => `${clockOn(t1 - t0, mark.t)} ${mark.text}`).join(" · ")}</p>`}
    ${!plain && html`<${TimeTools} view=${view} at=${at.value} pick=${pick.value} end=${numbers.toggle} />`}</div>${!plain && numbers.table}`;
}
