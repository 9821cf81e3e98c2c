// Two values against each other, as SVG.
import { html } from "./lib.js";
import { labels } from "./format.js";
import { useNumbers } from "./numbers.js";

/** Round values between two, about `n` of them. */
export function steps(low, high, n = 4) {
  const raw = (high - low) / n || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].find((k) => k * power >= raw * 0.999) * power;
  const out = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) out.push(Number(value.toPrecision(12)));
  return out;
}

/** The span of values with some air, at least `least` wide. */
export function span(values, least = 0) {
  const known = values.filter(Number.isFinite);
  if (!known.length) return [-1, 1];
  let [low, high] = [Math.min(...known), Math.max(...known)];
  if (high - low < least) { const middle = (high + low) / 2; [low, high] = [middle - least / 2, middle + least / 2]; }
  const air = (high - low || Math.abs(high) || 1) * 0.08;
  return [low - air, high + air];
}

/**
 * `points`: `{ x, y, kind: "dot" | "ring" | "hollow" | "cross", error, title }`, one without `y` stands at the foot; `lines`: lists of `[x, y]`; `zone`: a part of x, `best` its middle.
 * `equal`: both axes have one scale, also on the screen, around zero. `table()` gives its heads and rows.
 */
export function Plane({ points, lines = [], xName, yName, label, height = 300, width = 380, equal, table, zone = null, best = null }) {
  const [left, bottom, right, top] = [48, 34, 12, 10];
  const numbers = useNumbers(label, `${points.length} ${JSON.stringify(points[points.length - 1])}`, table);
  let xs = span([...points.map((p) => p.x), ...lines.flat().map(([x]) => x)]);
  let ys = span([...points.map((p) => p.y), ...lines.flat().map(([, y]) => y)]);
  if (equal) {
    const most = Math.max(...[...xs, ...ys].map(Math.abs));
    const aspect = (width - left - right) / (height - bottom - top);
    xs = [-1, 1].map((side) => side * most * Math.max(1, aspect));
    ys = [-1, 1].map((side) => side * most * Math.max(1, 1 / aspect));
  }
  const X = (value) => left + ((value - xs[0]) / (xs[1] - xs[0])) * (width - left - right);
  const Y = (value) => height - bottom - ((value - ys[0]) / (ys[1] - ys[0])) * (height - bottom - top);
  const [ticksX, ticksY] = [steps(...xs), steps(...ys)];
  return html`<div class="chart"><svg viewBox=${`0 0 ${width} ${height}`} height=${height} role="img" aria-label=${label}><rect class="frame-bg" x=${left} y=${top} width=${width - left - right} height=${height - bottom - top} />
    ${zone && html`<rect class="limzone" x=${X(Math.max(zone[0], xs[0]))} y=${top} width=${Math.max(0, X(Math.min(zone[1], xs[1])) - X(Math.max(zone[0], xs[0])))} height=${height - bottom - top} />`}${best !== null && best >= xs[0] && best <= xs[1] && html`<path class="mark" d=${`M${X(best)} ${top}V${height - bottom}`} />`}
    ${ticksY.map((value, i) => html`<g key=${`y${value}`}><path class="ax" d=${`M${left} ${Y(value).toFixed(1)}H${width - right}`} /><text x=${left - 7} y=${Y(value) + 4} text-anchor="end">${labels(ticksY)[i]}</text></g>`)}
    ${ticksX.map((value, i) => html`<g key=${`x${value}`}><path class="ax" d=${`M${X(value).toFixed(1)} ${top}V${height - bottom}`} /><text x=${X(value)} y=${height - bottom + 15} text-anchor="middle">${labels(ticksX)[i]}</text></g>`)}
    <text x=${(left + width - right) / 2} y=${height - 3} text-anchor="middle">${xName}</text><text class="h" x=${left + 8} y=${top + 15}>${yName}</text>
    ${equal && html`<path class="lim" d=${`M${X(0)} ${top}V${height - bottom}M${left} ${Y(0)}H${width - right}`} />`}
    ${lines.map((line, i) => html`<path key=${`l${i}`} class="ln s4" d=${line.map(([x, y], k) => `${k ? "L" : "M"}${X(x).toFixed(1)} ${Y(y).toFixed(1)}`).join("")} />`)}
    ${points.filter((p) => Number.isFinite(p.x) && (Number.isFinite(p.y) || p.kind === "cross")).map((p, i) => html`<g key=${`p${i}`}><title>${p.title ?? ""}</title>${p.error > 0 && html`<path class="ln s4" d=${`M${X(p.x)} ${Y(p.y - p.error)}V${Y(p.y + p.error)}`} />`}
      ${p.kind === "cross" ? html`<path class="ln cross" d=${`M${X(p.x) - 4} ${(Number.isFinite(p.y) ? Y(p.y) : height - bottom - 12) - 4}l8 8m0-8l-8 8`} />` : html`<circle class=${`pt ${{ ring: "s2", hollow: "hollow" }[p.kind] ?? "s1"}`} cx=${X(p.x)} cy=${Y(p.y)} r="3" />`}</g>`)}</svg></div>${table && html`<div class="time-tools">${numbers.toggle}</div>${numbers.table}`}`;
}
