// What a chart shows as a table: the same points, to be read row by row, or copied as CSV.
import { html, useMemo, useSignal } from "./lib.js";
import { number, plain } from "./format.js";
import { Table } from "./parts.js";

/** So many rows are made at once. */
const STEP = 100;
let count = 0;

const stamp = (ms) => new Date(ms).toISOString();
const headOf = ({ name, unit }) => (unit ? `${name}, ${unit}` : name);

/** A value in a cell; a time has its date and its seconds. What was not measured is a dash, and where a series has no point nothing stands. */
function cell(value, head) {
  if (value === undefined) return "";
  if (head.isTime) return Number.isFinite(value) ? stamp(value).slice(0, 19).replace("T", " ") : "—";
  return Number.isFinite(value) && head.digits !== undefined ? number(value, head.digits) : plain(value);
}

/** A text from outside stays a text where a spreadsheet would take it for a formula. */
function quoted(value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return Number.isFinite(value) ? String(value) : "";
  const text = plain(value).replace(/^[=+\-@\t\r]/, "'$&");
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** Heads and rows as CSV, in the order of the rows: full digits, times as RFC 3339. */
export function csv(heads, rows) {
  const lines = [heads.map((head) => quoted(head.isTime ? "time_utc" : head.unit ? `${head.name} (${head.unit})` : head.name))];
  for (const row of rows) lines.push(row.map((value, i) => quoted(heads[i].isTime && Number.isFinite(value) ? stamp(value) : value)));
  return lines.map((line) => `${line.join(",")}\n`).join("");
}

/** Gives a text to the clipboard; false where the browser does not let it. Without TLS there is only the old way, by what is marked. */
async function copied(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch { /* the old way */ }
  const field = document.createElement("textarea");
  field.value = text;
  const before = /** @type {HTMLElement} */ (document.activeElement);
  document.body.append(field);
  field.select();
  const done = document.execCommand("copy");
  field.remove();
  before?.focus();
  return done;
}

function Numbers({ id, label, heads, rows }) {
  const most = useSignal(STEP);
  const said = useSignal("");
  const byHand = useSignal("");
  const copy = async () => {
    // A file begins with what came first.
    const text = csv(heads, heads[0].isTime ? [...rows].reverse() : rows);
    const done = await copied(text);
    said.value = done ? `Copied: ${rows.length} rows.` : "The browser does not let the page copy. Mark the text below, and copy it.";
    byHand.value = done ? "" : text;
  };
  return html`<div class="numbers" id=${id} data-testid="numbers" data-rows=${rows.length}><div class="row between wrap"><span class="m" role="status">${said.value || `${rows.length} ${rows.length === 1 ? "row" : "rows"} of what is in view${heads[0].isTime ? ", the newest first" : ""}`}</span><button type="button" class="btn sm soft" onClick=${copy}>Copy as CSV</button></div>
    ${byHand.value && html`<textarea class="code" readonly rows="6" aria-label=${`${label} as CSV`}>${byHand.value}</textarea>`}
    <${Table} label=${`Values of: ${label}`} columns=${heads.map((head, i) => ({ key: String(i), name: headOf(head), num: head.isTime || head.digits !== undefined }))} rows=${rows.slice(0, most.value)} keyOf=${(row) => rows.indexOf(row)} cells=${(row) => row.map((value, i) => (i ? html`<td key=${i} class=${heads[i].digits !== undefined ? "num" : ""}>${cell(value, heads[i])}</td>` : html`<th key="0" scope="row" class="num">${cell(value, heads[i])}</th>`))} />
    ${rows.length > most.value && html`<p><button type="button" class="btn sm soft" onClick=${() => { most.value += STEP; }}>${Math.min(STEP, rows.length - most.value)} more rows</button></p>`}</div>`;
}

/**
 * `{ toggle, table }`: a button, and below what it belongs to the table that the button shows. `make()` gives `{ heads, rows }`: heads are `{ name, unit,
 * digits, isTime }`, a row is a list of values, times in ms. It is made again when `key` changes, not each second.
 */
export function useNumbers(label, key, make) {
  const open = useSignal(false);
  const id = useMemo(() => `numbers${count += 1}`, []);
  const toggle = html`<button type="button" class="btn sm soft" aria-expanded=${String(open.value)} aria-controls=${open.value ? id : null} aria-label=${`Table of values: ${label}`} onClick=${() => { open.value = !open.value; }}>Table</button>`;
  const table = useMemo(() => open.value && html`<${Numbers} id=${id} label=${label} ...${make()} />`, [open.value, key, label]);
  return { toggle, table };
}
