// The schedule: rows of tonight and their forecast; a draft of the next one, with findings while it is written, a dry run, the difference, and activation.
import { html, useEffect, useRef, useSignal } from "../lib.js";
import { ask, useGet, useReport } from "../api.js";
import { note } from "../close.js";
import { useForecast } from "../forecast.js";
import { clock, duration, hourMinute, nightOf, number } from "../format.js";
import { Keys, Night } from "../night.js";
import { Card, Dialog, Empty, Loaded, Table } from "../parts.js";
import { RowForm, rowOf } from "../row.js";
import { useSite } from "../site.js";
import { skyNow, tick, useTopic } from "../store.js";

const SHAPES = { pending: "·", running: "▶", interrupted: "‖", finished: "✓", failed: "✕", skipped: "–" };
const base = (id) => `/api/v1/telescopes/${id}/schedule`;
const JSONL = { "Content-Type": "application/jsonl" };

/** The text in force, with its ETag. */
async function textInForce(id) {
  const response = await fetch(base(id), { headers: { Accept: "application/jsonl" } });
  if (!response.ok) throw new Error((await response.json().catch(() => null))?.detail ?? `The server answered ${response.status}.`);
  return { text: await response.text(), etag: response.headers.get("etag") };
}

function Rows({ rows, plan }) {
  const forecast = new Map((plan?.rows ?? []).map((row) => [row.row, row]));
  const columns = [{ key: "r", name: "Row", num: true }, { key: "w", name: "What" }, { key: "t", name: "Window, UTC" }, { key: "f", name: "Frames", num: true }, { key: "s", name: "Status" }, { key: "p", name: "Forecast", cls: "hidep" }];
  return html`<${Table} label="Rows of tonight" columns=${columns} rows=${rows} keyOf=${(row) => row.row} rowProps=${(row) => ({ "data-testid": "schedule-row", "data-row": row.row, "data-status": row.status })} cells=${(row) => {
    const ahead = forecast.get(row.row);
    return html`<td class="num">${row.row + 1}</td><td class="k">${[row.action, row.object].filter(Boolean).join(" ")} <span class="mm">${row.camera ?? ""}</span></td><td>${hourMinute(row.start_utc)} – ${hourMinute(row.end_utc)}</td><td class="num">${row.frames || row.frames_wanted ? `${row.frames}${row.frames_wanted != null ? ` of ${row.frames_wanted}` : ""}` : ""}</td>
      <td><span aria-hidden="true">${SHAPES[row.status] ?? "?"}</span> ${row.status}${row.detail ? html` <span class="m">${row.detail}</span>` : ""}</td><td class="hidep m">${ahead && row.status !== "finished" ? `${hourMinute(ahead.start_utc)} to ${hourMinute(ahead.end_utc)}${ahead.frames_wanted ? `, ${ahead.frames} frames` : ""}${ahead.note ? `; ${ahead.note}` : ""}` : ""}</td>`;
  }} />`;
}

/** Findings stand with their line; a touch goes there. */
const Findings = ({ findings, onGo }) => (findings.length ? html`<ul class="findings" data-testid="findings">${findings.map((finding, i) => html`<li key=${i} class=${`note ${finding.severity === "error" ? "p2" : "p3"}`}><button class="btn sm quiet" onClick=${() => onGo(finding)}>line ${finding.line ?? "—"}</button><span class="grow"><b>${finding.field ?? finding.check}</b> ${finding.what}${finding.right ? `; ${finding.right}` : ""}</span></li>`)}</ul>` : html`<p class="m">No findings.</p>`);

function Editor({ id, onDone }) {
  const text = useSignal(null);
  const inForce = useSignal(null);
  const draft = useSignal(null);
  const checked = useSignal(null);
  const dry = useSignal(null);
  const changes = useSignal(null);
  const problem = useSignal(null);
  const activating = useSignal(false);
  /** The row whose form is open: its line, from 0, and whether it takes the line's place. */
  const form = useSignal(null);
  const caret = useSignal(0);
  const area = useRef(null);
  const site = useSite(id, null);
  const name = `${base(id)}/drafts/page`;
  const fail = (error) => { problem.value = error; };
  useEffect(() => {
    (async () => {
      const current = await textInForce(id);
      inForce.value = current;
      try {
        const found = await ask(name);
        draft.value = { etag: found.etag, author: found.author, changed_utc: found.changed_utc };
        text.value = found.text;
      } catch (error) {
        if (error.status !== 404) throw error;
        text.value = current.text;
      }
    })().catch(fail);
  }, [id]);
  // Findings come while it is written, and never hold up the writing.
  useEffect(() => {
    if (text.value === null) return undefined;
    const timer = setTimeout(() => ask(`${base(id)}/validate`, { method: "POST", headers: JSONL, body: text.peek() }).then((found) => { checked.value = found; problem.value = null; }).catch(fail), 500);
    return () => clearTimeout(timer);
  }, [text.value]);
  const save = async () => {
    const etag = draft.peek()?.etag;
    const found = await ask(name, { method: "PUT", headers: { ...JSONL, ...(etag ? { "If-Match": `"${etag.replaceAll('"', "")}"` } : { "If-None-Match": "*" }) }, body: text.peek() });
    draft.value = { etag: found.etag, author: found.author, changed_utc: found.changed_utc };
    return found;
  };
  const press = (work) => () => work().catch((error) => {
    if (error.status === 412) problem.value = new Error("Somebody else changed this draft meanwhile. Copy what you wrote, and load the draft again.");
    else fail(error);
  });
  const simulate = async () => { dry.value = await ask(`${base(id)}/simulate`, { method: "POST", headers: JSONL, body: text.peek() }); };
  const compare = async () => { await save(); changes.value = await ask(`${name}/diff`); };
  const goTo = (finding) => {
    const lines = text.peek().split("\n");
    const at = lines.slice(0, (finding.line ?? 1) - 1).reduce((sum, line) => sum + line.length + 1, 0) + (finding.column ?? 1) - 1;
    area.current.focus();
    area.current.setSelectionRange(at, at + 1);
  };
  const activate = async (event) => {
    event.preventDefault();
    const reason = new FormData(event.target).get("reason");
    await save();
    const say = note(`${id}: the schedule is being activated …`, true);
    const command = await ask(`${name}/activate`, { method: "POST", headers: { "Content-Type": "application/json", "Idempotency-Key": `${Date.now()}-${Math.random()}`, "If-Match": inForce.peek().etag, Prefer: "wait=10" }, body: JSON.stringify({ reason }) }).catch((error) => { say(`${id}: not activated: ${error.message}`); throw error; });
    say(`${id}: the schedule is ${command.state}${command.detail ? `: ${command.detail}` : ""}`);
    activating.value = false;
    onDone();
  };
  // A row is put below the line of the caret; one that is changed stays where it is.
  const put = (line) => {
    const { at, row } = form.peek();
    const lines = text.peek().split("\n");
    lines.splice(row ? at : lines[at]?.trim() ? at + 1 : at, row || !lines[at]?.trim() ? 1 : 0, line);
    text.value = lines.join("\n");
    form.value = null;
  };
  const discard = async () => {
    if (draft.peek()) await ask(name, { method: "DELETE", headers: { "If-Match": `"${draft.peek().etag.replaceAll('"', "")}"` } });
    draft.value = null;
    inForce.value = await textInForce(id);
    text.value = inForce.peek().text;
    changes.value = null;
    dry.value = null;
  };
  if (text.value === null) return problem.value ? html`<${Empty} icon="warn" title="The schedule cannot be read" hatch>${problem.value.message}<//>` : html`<p class="m">Reading the schedule …</p>`;
  const findings = checked.value?.findings ?? [];
  const errors = checked.value?.errors ?? 0;
  const lines = text.value.split("\n");
  const here = Math.min(lines.length - 1, text.value.slice(0, caret.value).split("\n").length - 1);
  const rowHere = rowOf(lines[here]);
  const rows = lines.map(rowOf).filter(Boolean);
  const cameras = [...new Set(rows.map((row) => row.device_name).filter((name) => typeof name === "string"))];
  const latest = rows[rows.length - 1];
  const moved = (event) => { caret.value = event.target.selectionStart; };
  const marked = new Map(findings.map((finding) => [finding.line, finding.severity]));
  return html`<${Card} name="Draft" end=${draft.value ? `stored by ${draft.value.author}, ${clock(draft.value.changed_utc)}` : "not stored yet; it begins as the schedule in force"}>
      ${problem.value && html`<div class="note p2" role="alert"><span class="grow">${problem.value.message}</span></div>`}
      <div class="row wrap"><span data-testid="check"><b>${errors}</b> ${errors === 1 ? "error" : "errors"}, <b>${checked.value?.warnings ?? 0}</b> warnings, ${checked.value?.rows ?? "?"} rows</span><span class="grow"></span><button class="btn soft sm" data-testid="add-row" onClick=${() => { form.value = { at: here, row: null }; }}>Add a row …</button><button class="btn soft sm" data-testid="change-row" disabled=${!rowHere} onClick=${() => { form.value = { at: here, row: rowHere }; }}>${rowHere ? `Change line ${here + 1} …` : "Change a row …"}</button><button class="btn quiet sm" onClick=${press(discard)}>Start over</button><button class="btn soft" onClick=${press(save)}>Store</button><button class="btn soft" onClick=${press(compare)}>Difference</button><button class="btn soft" disabled=${errors > 0} onClick=${press(simulate)}>Dry run</button>
        <button class="btn main" disabled=${errors > 0} onClick=${() => { activating.value = true; }}>Activate …</button></div>${errors > 0 && html`<p class="why">Activate and the dry run wait for ${errors === 1 ? "the error" : `${errors} errors`} below.</p>`}
      <div class="editor"><div class="gutter" aria-hidden="true">${lines.map((_, i) => html`<span key=${i} class=${marked.get(i + 1) ?? ""}>${i + 1}</span>`)}</div><textarea ref=${area} aria-label="Schedule, one row a line" spellcheck="false" wrap="off" rows=${Math.min(40, Math.max(8, lines.length + 1))} value=${text.value} onInput=${(event) => { text.value = event.target.value; moved(event); }} onKeyUp=${moved} onClick=${moved} onFocus=${moved}></textarea></div>${!rowHere && html`<p class="why">To change a row by its form, put the cursor into its line; it must stand on one line.</p>`}
      <${Findings} findings=${findings} onGo=${goTo} /><//>
    ${changes.value && html`<${Card} name="Difference to the schedule in force" flush>${changes.value.same ? html`<p class="m pad">No row differs.</p>` : html`<${Table} label="Difference" columns=${[{ key: "c", name: "Change" }, { key: "l", name: "Line", num: true }, { key: "w", name: "Row" }]} rows=${changes.value.changes} keyOf=${(one) => `${one.change} ${one.line_before} ${one.line_after}`} cells=${(one) => html`<td>${one.change}</td><td class="num">${one.line_after ?? one.line_before}</td><td class="pre mono">${(one.fields ?? []).length ? one.fields.map((field) => `${field.field}: ${JSON.stringify(field.before)} → ${JSON.stringify(field.after)}`).join("\n") : JSON.stringify(one.after ?? one.before)}</td>`} />`}<//>`}
    ${dry.value && html`<${Card} name="Dry run" end=${dry.value.night && `${dry.value.night.frames} frames, ${number(dry.value.night.gigabytes, 1)} GB, ${duration(dry.value.night.dark_exposed_s)} of ${duration(dry.value.night.dark_s)} dark time exposed`}><${Night} rows=${dry.value.rows.map((row) => ({ ...row, start_utc: row.window_utc[0], end_utc: row.window_utc[1] }))} plan=${dry.value.rows} site=${site} now=${skyNow()} label="Forecast of the draft" />
      <${Table} label="Forecast" columns=${[{ key: "r", name: "Row", num: true }, { key: "w", name: "What" }, { key: "b", name: "Begins" }, { key: "e", name: "Ends" }, { key: "f", name: "Frames", num: true }, { key: "n", name: "" }]} rows=${dry.value.rows} keyOf=${(row) => row.row} cells=${(row) => html`<td class="num">${row.row + 1}</td><td class="k">${[row.action, row.object].filter(Boolean).join(" ")}</td><td>${row.start_utc ? clock(row.start_utc) : "—"}</td><td>${row.end_utc ? clock(row.end_utc) : "—"}</td><td class="num">${row.frames_wanted ? `${row.frames} of ${row.frames_wanted}` : row.frames || ""}</td><td class="m">${row.note ?? (row.whole === false ? "not whole" : "")}</td>`} /><//>`}
    ${form.value && html`<${RowForm} id=${id} row=${form.value.row} cameras=${cameras} window=${[latest?.end_time ?? "", ""]} onDone=${put} close=${() => { form.value = null; }} />`}
    ${activating.value && html`<${Dialog} label="Activate the draft" close=${() => { activating.value = false; }}><h2>Put this schedule in force?</h2><p class="m">${lines.filter((line) => line.trim().startsWith("{")).length} rows take the place of those in force. A row that runs goes on if it is in both.</p><form class="stack" onSubmit=${(event) => activate(event).catch(fail)}><div class="field"><label for="why">Why</label><div class="in"><input id="why" name="reason" data-first maxlength="500" required /></div></div><div class="acts"><button type="button" class="btn soft" onClick=${() => { activating.value = false; }}>Cancel</button><button class="btn main">Activate</button></div></form><//>`}`;
}

function Revisions({ id }) {
  const found = useGet(`${base(id)}/revisions?limit=10`, 60);
  return html`<${Card} name="Schedules that were in force" flush><${Loaded} of=${found} what="The list">${(list) => html`<${Table} label="Revisions" columns=${[{ key: "v", name: "Version", num: true }, { key: "t", name: "From" }, { key: "a", name: "By" }, { key: "r", name: "Why" }, { key: "n", name: "Rows", num: true }]} rows=${list} keyOf=${(one) => one.version} cells=${(one) => html`<td class="num"><a href=${`${base(id)}/revisions/${one.version}`} target="_blank">${one.version}</a></td><td>${clock(one.at_utc)}</td><td>${one.author}</td><td>${one.reason ?? ""}</td><td class="num">${one.rows}</td>`} />`}<//><//>`;
}

export function Schedule({ id }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}/observatory/schedule`);
  const entry = states?.get(`${id}/observatory/schedule/state`);
  const plan = useForecast(id);
  const site = useSite(id, null);
  const editing = useSignal(false);
  const report = useReport(id, skyNow() && nightOf(skyNow()));
  if (!entry) return html`<p class="m">No schedule received yet.</p>`;
  const { rows, file, revision, refused } = entry.body;
  return html`<${Card} name="The night" end=${html`<${Keys} />`} cls="tl"><${Night} rows=${rows} plan=${plan?.rows} report=${report.data} site=${site} now=${skyNow()} /><//>
    ${refused && html`<div class="note p2"><span class="grow"><b>The file's newest text was not taken.</b> ${refused}</span></div>`}
    <${Card} name="Rows of tonight" flush end=${html`<span class="mono">${file}</span>, version ${revision} <button class="btn sm soft" onClick=${() => { editing.value = !editing.value; }}>${editing.value ? "Close the draft" : "Edit a draft"}</button>`}><${Rows} rows=${rows} plan=${plan} /><//>
    ${editing.value && html`<${Editor} id=${id} onDone=${() => { editing.value = false; }} />`}<${Revisions} id=${id} />`;
}
