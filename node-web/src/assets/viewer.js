// A frame to look into: fit, 1:1 or 4:1, dragged and zoomed, with the value and the place under the pointer.
import { html, useEffect, useRef, useSignal } from "./lib.js";
import { declination, number, rightAscension } from "./format.js";
import { drawn, greys, pixelOf, skyOf } from "./pixels.js";

const TILE = 256;
const MOST_TILES = 400;

/** Lines of the grid in right ascension and declination: `{ points, name, along }`, in pixels of the frame; `along` is the direction in which the name is looked for. */
function grid(wcs, width, height) {
  const corners = [[0, 0], [width, 0], [0, height], [width, height]].map(([x, y]) => skyOf(wcs, x, y));
  const centre = skyOf(wcs, width / 2, height / 2);
  if (!centre || corners.some((corner) => !corner)) return [];
  const decs = corners.map(([, dec]) => dec);
  const [low, high] = [Math.min(...decs), Math.max(...decs)];
  const step = [10, 5, 2, 1, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01].find((one) => (high - low) / one >= 3) ?? 0.01;
  const across = step / Math.max(0.05, Math.cos(centre[1] * Math.PI / 180));
  const raStep = [30, 15, 7.5, 3.75, 2.5, 1.25, 0.625, 0.25, 0.125, 0.0625, 0.025].find((one) => one <= across * 1.6) ?? 0.025;
  const lines = [];
  for (let dec = Math.ceil((low - step) / step) * step; dec <= high + step; dec += step) {
    lines.push({ name: declination(dec), along: 0, points: Array.from({ length: 33 }, (_, i) => pixelOf(wcs, centre[0] + (i - 16) * raStep / 4, dec)).filter(Boolean) });
  }
  const n = Math.ceil(6);
  for (let i = -n; i <= n; i += 1) {
    const ra = Math.round(centre[0] / raStep + i) * raStep;
    lines.push({ name: rightAscension(ra).slice(0, 8), along: 1, points: Array.from({ length: 25 }, (_, k) => pixelOf(wcs, ra, low - step + ((high - low + 2 * step) * k) / 24)).filter(Boolean) });
  }
  return lines;
}

/** Where the name of a line stands: on it, near the left or the upper edge of what is in view, or nowhere. */
function namePlace({ points, along }, { x, y, w, h, scale }) {
  const [left, top, right, bottom] = [x + 8 / scale, y + 16 / scale, x + (w - 80) / scale, y + (h - 40) / scale];
  const all = points.slice(1).flatMap(([bx, by], i) => { const [ax, ay] = points[i]; return Array.from({ length: 40 }, (_, n) => [ax + ((bx - ax) * n) / 40, ay + ((by - ay) * n) / 40]); });
  return all.filter(([px, py]) => px >= left && px <= right && py >= top && py <= bottom).reduce((best, one) => (!best || one[along] < best[along] ? one : best), null);
}

/** `tiles`: a `Tiles`; `stretch`: black and white in numbers of tiles, curve, invert; `layers`: a set of `grid`, `target`. `onRead` is told why tiles are missing, null where none is;
    another `again` asks for those. */
export function Viewer({ tiles, width, height, stretch, zoom, layers, wcs, target, again, onRead }) {
  const place = useRef(null);
  const canvas = useRef(null);
  const view = useRef({ cx: width / 2, cy: height / 2, scale: 0 });
  const pictures = useRef({ key: "", map: new Map() });
  const under = useSignal(null);
  const frameOfView = useSignal({ x: 0, y: 0, scale: 1, w: 100, h: 100 });
  const busy = useRef(false);
  const turn = useRef(0);

  const paint = async () => {
    const element = canvas.current;
    if (!element) return;
    const box = element.getBoundingClientRect();
    const ratio = devicePixelRatio || 1;
    if (element.width !== Math.round(box.width * ratio)) {
      element.width = Math.round(box.width * ratio);
      element.height = Math.round(box.height * ratio);
    }
    const fit = Math.min(box.width / width, box.height / height);
    const state = view.current;
    const scale = state.scale || fit;
    const [left, top] = [state.cx - box.width / 2 / scale, state.cy - box.height / 2 / scale];
    frameOfView.value = { x: left, y: top, scale, w: box.width, h: box.height };
    const highest = tiles.highest ?? 0;
    // The coarsest level whose numbers are not larger than the pixels of the screen.
    const z = Math.max(0, Math.min(highest, highest + Math.ceil(Math.log2(Math.min(1, scale * ratio)) - 1e-6)));
    const factor = 2 ** (highest - z);
    const span = TILE * factor;
    const key = JSON.stringify(stretch);
    if (pictures.current.key !== key || pictures.current.tiles !== tiles) pictures.current = { key, tiles, map: new Map(), table: greys(stretch) };
    const { map, table } = pictures.current;
    const wanted = [];
    for (let y = Math.max(0, Math.floor(top / span)); y * span < Math.min(height, top + box.height / scale); y += 1) {
      for (let x = Math.max(0, Math.floor(left / span)); x * span < Math.min(width, left + box.width / scale); x += 1) wanted.push([x, y]);
    }
    if (wanted.length > MOST_TILES) return;
    const draw = () => {
      const ctx = element.getContext("2d");
      ctx.setTransform(1, 0, 0, 1, 0, 0);
      ctx.fillStyle = "#000";
      ctx.fillRect(0, 0, element.width, element.height);
      ctx.imageSmoothingEnabled = scale * factor < 1;
      const put = (picture, x, y, across, down) => ctx.drawImage(picture, (x - left) * scale * ratio, (y - top) * scale * ratio, across * scale * ratio, down * scale * ratio);
      // The whole frame is there first; where finer pixels are not, it stands for them.
      const whole = map.get("0/0/0");
      if (whole && wanted.some(([x, y]) => !map.has(`${z}/${x}/${y}`))) put(whole, 0, 0, width, height);
      for (const [x, y] of wanted) {
        const picture = map.get(`${z}/${x}/${y}`);
        if (picture) put(picture, x * span, y * span, picture.width * factor, picture.height * factor);
      }
    };
    const read = async (level, x, y) => {
      const name = `${level}/${x}/${y}`;
      if (map.has(name)) return;
      const tile = await tiles.get(level, x, y);
      if (tile) map.set(name, drawn(tile, table, tiles.blank));
    };
    // Of two that wait for tiles only the later one shows what is in view.
    turn.current += 1;
    const mine = turn.current;
    await read(0, 0, 0).catch(() => {});
    if (turn.current === mine) draw();
    await Promise.all(wanted.map(([x, y]) => read(z, x, y))).then(() => onRead?.(null), (error) => onRead?.(error));
    if (turn.current !== mine) return;
    draw();
    element.dataset.painted = String(wanted.length);
  };
  const repaint = () => {
    if (busy.current) return;
    busy.current = true;
    requestAnimationFrame(async () => {
      busy.current = false;
      await paint();
    });
  };
  useEffect(() => {
    view.current.scale = { fit: 0, "1": 1, "4": 4 }[zoom] ?? 0;
    if (zoom === "fit") Object.assign(view.current, { cx: width / 2, cy: height / 2 });
    repaint();
  }, [zoom, tiles, JSON.stringify(stretch)]);
  useEffect(() => repaint(), [again]);
  useEffect(() => {
    const observer = new ResizeObserver(repaint);
    observer.observe(place.current);
    return () => observer.disconnect();
  }, []);

  const at = (event) => {
    // What is painted fills the box, also where that has another size since.
    const box = canvas.current.getBoundingClientRect();
    const { x, y, scale, w, h } = frameOfView.peek();
    return [x + ((event.clientX - box.left) * w) / box.width / scale, y + ((event.clientY - box.top) * h) / box.height / scale];
  };
  const latest = useRef(tiles);
  latest.current = tiles;
  const read = async (x, y) => {
    const [px, py] = [Math.floor(x), Math.floor(y)];
    if (px < 0 || py < 0 || px >= width || py >= height) { under.value = null; return; }
    const before = under.peek();
    // Until its own number is there it has none: that of another pixel would be wrong.
    under.value = { px, py, sky: skyOf(wcs, px, py), counts: before?.px === px && before.py === py ? before.counts : undefined };
    const tile = await tiles.get(tiles.highest ?? 0, Math.floor(px / TILE), Math.floor(py / TILE)).catch(() => null);
    if (tile && latest.current === tiles && under.peek()?.px === px && under.peek()?.py === py) under.value = { ...under.peek(), counts: tiles.counts(tile.values[(py % TILE) * tile.width + (px % TILE)]) };
  };
  // Another frame has another number there.
  useEffect(() => {
    const before = under.peek();
    under.value = null;
    if (before) read(before.px, before.py);
  }, [tiles, wcs]);
  const drag = useRef(null);
  const handlers = {
    onPointerDown: (event) => { read(...at(event)); drag.current = { x: event.clientX, y: event.clientY, cx: view.current.cx, cy: view.current.cy }; event.currentTarget.setPointerCapture?.(event.pointerId); },
    onPointerMove: (event) => {
      if (drag.current) {
        const { scale } = frameOfView.peek();
        view.current.cx = drag.current.cx - (event.clientX - drag.current.x) / scale;
        view.current.cy = drag.current.cy - (event.clientY - drag.current.y) / scale;
        repaint();
        // The pixel under the pointer is dragged with it.
        return;
      }
      read(...at(event));
    },
    onPointerUp: () => { drag.current = null; },
    onWheel: (event) => {
      event.preventDefault();
      // Several turns may come before the next paint: each goes on from what the one before made of the view.
      const box = canvas.current.getBoundingClientRect();
      const fit = Math.min(box.width / width, box.height / height);
      const { cx, cy, scale } = view.current;
      const before = scale || fit;
      const after = Math.min(16, Math.max(before * 2 ** (-event.deltaY / 300), fit));
      // What is under the pointer stays there.
      const [dx, dy] = [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2].map((px) => px / before - px / after);
      Object.assign(view.current, { scale: after, cx: cx + dx, cy: cy + dy });
      repaint();
    },
    onKeyDown: (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (!step) return;
      event.preventDefault();
      const { scale, w, h } = frameOfView.peek();
      view.current.cx += (step[0] * w) / 8 / scale;
      view.current.cy += (step[1] * h) / 8 / scale;
      repaint();
      read(view.current.cx, view.current.cy);
    },
  };
  const now = frameOfView.value;
  const mark = target && pixelOf(wcs, target[0], target[1]);
  const shown = under.value;
  return html`<div class="viewer live" ref=${place} tabindex="0" role="img" aria-label="The frame; drag or arrow keys move it, the wheel zooms" data-testid="viewer" ...${handlers}><canvas ref=${canvas}></canvas>
    <svg viewBox=${`${now.x} ${now.y} ${now.w / now.scale} ${now.h / now.scale}`} preserveAspectRatio="none" aria-hidden="true">${layers.has("grid") && wcs && grid(wcs, width, height).map((line, i) => { const at = namePlace(line, now); return html`<g key=${i}><path class="wcs" d=${line.points.map(([x, y], n) => `${n ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("")} vector-effect="non-scaling-stroke" />${at && html`<text x=${at[0] + 4 / now.scale} y=${at[1] - 4 / now.scale} style=${{ "--fs": `${12 / now.scale}px`, strokeWidth: `${3 / now.scale}` }}>${line.name}</text>`}</g>`; })}
      ${layers.has("target") && mark && html`<circle class="tgt" cx=${mark[0]} cy=${mark[1]} r=${18 / now.scale} vector-effect="non-scaling-stroke" />`}</svg>
    <div class="hud" data-testid="readout">${shown ? html`<b>x ${shown.px + 1}  y ${shown.py + 1}</b><span>${Number.isFinite(shown.counts) ? `${number(shown.counts, 0)} ADU` : "—"}</span>${shown.sky && html`<span>${rightAscension(shown.sky[0])} ${declination(shown.sky[1])}</span>`}` : html`<span>point at a pixel</span>`}</div></div>`;
}
