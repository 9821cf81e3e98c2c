// One row of a schedule as a form: the action, its parameters by their schema, and its window. What it gives is a line of the draft.
import { html, useRef, useSignal } from "./lib.js";
import { useShared } from "./api.js";
import { Field, valuesOf } from "./form.js";
import { Dialog, Loaded } from "./parts.js";

/** Keys of a row beside the parameters. */
const COMMON = ["device_name", "action_type", "action_value", "start_time", "end_time", "programme"];

/** The row in a line of a schedule; null where the line is no whole row. */
export function rowOf(line) {
  try {
    const row = JSON.parse(line);
    return row && typeof row === "object" && !Array.isArray(row) ? row : null;
  } catch {
    return null;
  }
}

/** A line of a schedule, with its keys in the usual order. */
const lineOf = (row) => JSON.stringify(Object.fromEntries([...COMMON, ...Object.keys(row).filter((key) => !COMMON.includes(key))].filter((key) => row[key] !== undefined && row[key] !== "").map((key) => [key, row[key]])));

function Parameters({ schema, value }) {
  const properties = Object.entries(schema?.properties ?? {});
  if (!properties.length) return html`<p class="m">This action has no parameters.</p>`;
  const required = new Set(schema.required ?? []);
  const field = ([path, one]) => html`<${Field} key=${path} path=${path} schema=${one} required=${required.has(path)} value=${value?.[path] ?? one.default} />`;
  const isUsed = ([path, _]) => required.has(path) || value?.[path] !== undefined;
  const rest = properties.filter((one) => !isUsed(one));
  return html`${properties.filter(isUsed).map(field)}${rest.length > 0 && html`<details open=${!value}><summary>${rest.length} more ${rest.length > 1 ? "parameters" : "parameter"}</summary><div class="stack">${rest.map(field)}</div></details>`}`;
}

/** `row`: what the form begins with; `cameras`: names to choose from; `onDone(line)` takes the line. */
export function RowForm({ id, row, cameras, window: [start, end], onDone, close }) {
  const actions = useShared(`/api/v1/telescopes/${id}/schedule/action-schemas`, 600);
  const form = useRef(null);
  const chosen = useSignal(row?.action_type ?? "object");
  const send = (list) => (event) => {
    event.preventDefault();
    const schema = list.find((one) => one.name === chosen.value)?.schema ?? {};
    const data = new FormData(form.current);
    onDone(lineOf({ ...row, device_name: data.get("device_name"), action_type: chosen.value, action_value: valuesOf(form.current, Object.entries(schema.properties ?? {}), true), start_time: data.get("start_time"), end_time: data.get("end_time"), programme: data.get("programme") || undefined }));
  };
  const text = (name, label, value, hint) => html`<div class="field"><label for=${name}>${label}</label><div class="in"><input id=${name} name=${name} defaultValue=${value} required=${name !== "programme"} list=${name === "device_name" ? "cameras" : null} /></div>${hint && html`<small>${hint}</small>`}</div>`;
  return html`<${Dialog} label=${row ? "Change a row" : "Add a row"} close=${close}><h2>${row ? "Change a row" : "Add a row"}</h2>
    <${Loaded} of=${actions} what="The list of actions">${(list) => {
      const action = list.find((one) => one.name === chosen.value);
      return html`<form ref=${form} class="stack" onSubmit=${send(list)} data-testid="row-form"><div class="field"><label for="action_type">Action</label><div class="in"><select id="action_type" data-first value=${chosen.value} onChange=${(event) => { chosen.value = event.target.value; }}>${list.map((one) => html`<option key=${one.name} selected=${one.name === chosen.value}>${one.name}</option>`)}</select></div><small>${action?.help ?? ""}${action?.needs_safe_sky ? " Needs a safe sky." : ""}</small></div>
        <div class="grid g2">${text("device_name", "Camera", row?.device_name ?? cameras[0] ?? "", null)}${text("programme", "Programme", row?.programme ?? "", "May be left empty.")}${text("start_time", "From, UTC", row?.start_time ?? start, null)}${text("end_time", "Until, UTC", row?.end_time ?? end, null)}</div><datalist id="cameras">${cameras.map((camera) => html`<option key=${camera} value=${camera} />`)}</datalist>
        <${Parameters} key=${chosen.value} schema=${action?.schema} value=${chosen.value === row?.action_type ? row.action_value : null} />
        <div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button><button class="btn main">${row ? "Change the line" : "Put it into the draft"}</button></div></form>`;
    }}<//><//>`;
}
