// The difference of two schedules, row by row: what is gone, and what takes its place.
import { html } from "./lib.js";
import { hourMinute } from "./format.js";
import { nameOf } from "./rowtext.js";

const MOST = 200;

/** `changes` as `difference` gives them. */
export function Changes({ changes, label }) {
  if (!changes.length) return html`<p class="m pad" data-testid="changes">No row differs.</p>`;
  const window = (one) => (Number.isFinite(one.start) ? `${hourMinute(one.start)} to ${hourMinute(one.end)}` : "");
  const line = (cls, word, one, text) => html`<div class=${cls}><span class="n">${one.line}</span><span class="c"><span class="vh">${word} </span><b>${nameOf(one.row) || "row"}</b> ${text}</span></div>`;
  const said = (fields, side) => fields.map((one) => `${one.field}: ${one[side] === undefined ? "—" : JSON.stringify(one[side])}`).join(", ");
  const whole = (one) => `${window(one)} ${JSON.stringify(one.row.action_value ?? {})}`;
  return html`<div class="code changes" tabindex="0" role="group" aria-label=${label} data-testid="changes">${changes.slice(0, MOST).map(({ change, before, after, fields }) => html`${before && line("del", change === "changed" ? "was" : "removed", before, change === "changed" ? said(fields, "before") : whole(before))}${after && line("add", change === "changed" ? "becomes" : "added", after, change === "changed" ? said(fields, "after") : whole(after))}`)}${changes.length > MOST && html`<div><span class="n"></span><span class="c">and ${changes.length - MOST} more</span></div>`}</div>`;
}
