// One row of a schedule as a form: the action, its parameters by their schema, and its window. A new row begins with a template of its action.
import { html, useMemo, useRef, useSignal } from "./lib.js";
import { useShared } from "./api.js";
import { Field, valuesOf } from "./form.js";
import { hourMinute } from "./format.js";
import { Dialog, Loaded } from "./parts.js";
import { nameOf, timeOf } from "./rowtext.js";

/** The actions that a telescope knows, with the schemas of their parameters. */
export const useActions = (id) => useShared(`/api/v1/telescopes/${id}/schedule/action-schemas`, 600);

function Parameters({ schema, value, filters }) {
  const properties = Object.entries(schema?.properties ?? {});
  if (!properties.length) return html`<p class="m">This action has no parameters.</p>`;
  const required = new Set(schema.required ?? []);
  // One filter is one of the wheel's; a list of them is written.
  const named = (path, one) => (path === "filter" && [one.type].flat().includes("string") && filters.length ? { ...one, enum: [...new Set([value[path], ...filters])].filter((word) => typeof word === "string") } : one);
  const field = ([path, one]) => html`<${Field} key=${path} path=${path} schema=${named(path, one)} required=${required.has(path)} value=${value[path] ?? one.default} />`;
  const isUsed = ([path, _]) => required.has(path) || value[path] !== undefined;
  const rest = properties.filter((one) => !isUsed(one));
  return html`${properties.filter(isUsed).map(field)}${rest.length > 0 && html`<details><summary>${rest.length} more ${rest.length > 1 ? "parameters" : "parameter"}</summary><div class="stack">${rest.map(field)}</div></details>`}`;
}

/** What the form says of the parameters: what is as its default is left out unless the row had it, and what the form does not know stays. */
function parametersOf(form, schema, before) {
  const properties = Object.entries(schema?.properties ?? {});
  const [given, all] = [valuesOf(form, properties, true), valuesOf(form, properties)];
  for (const [name, value] of Object.entries(before)) {
    const stays = name in all ? JSON.stringify(all[name]) === JSON.stringify(value) : value === null || !(name in (schema?.properties ?? {}));
    if (!(name in given) && stays) given[name] = value;
  }
  return given;
}

/** One template for each action, with what it would do. */
const Choice = ({ list, template, onChoose }) => html`<p class="m">Each begins with what this telescope did last, in the darkness of tonight that is left.</p><div class="stack" data-testid="templates">${list.map((action, i) => {
  const row = template(action);
  return html`<button key=${action.name} type="button" class="btn soft template" data-first=${i === 0 ? "" : null} onClick=${() => onChoose(action.name)}><b>${action.name}</b><span class="m grow cut">${[nameOf({ ...row, action_type: null }), row.action_value.filter].flat().filter((word) => typeof word === "string" && word).join(", ")}</span><span class="m">${hourMinute(timeOf(row.start_time))} – ${hourMinute(timeOf(row.end_time))}</span></button>`;
})}</div>`;

/** `row`: the row that is changed, or null for a new one, of which `template(action, list)` gives the beginning; `onDone(row)` takes it. */
export function RowForm({ id, row, template, cameras, filters, onDone, close }) {
  const actions = useActions(id);
  const form = useRef(null);
  const chosen = useSignal(row?.action_type ?? null);
  const action = actions.data?.find((one) => one.name === chosen.value);
  const begin = useMemo(() => {
    if (row?.action_type === chosen.value || !action) return row;
    const made = template(action, actions.data);
    return row ? { ...row, action_type: made.action_type, action_value: made.action_value } : made;
  }, [chosen.value, action]);
  const isKept = row?.action_type === chosen.value;
  const send = (event) => {
    event.preventDefault();
    const data = new FormData(form.current);
    const text = (name) => String(data.get(name) ?? "");
    const value = parametersOf(form.current, action?.schema, isKept && typeof row.action_value === "object" ? row.action_value ?? {} : {});
    const isLeftOut = isKept && (row.action_value ?? null) === null && !Object.keys(value).length;
    onDone({ ...row, device_name: text("device_name"), action_type: chosen.value, action_value: isLeftOut ? row.action_value : value, start_time: text("start_time"), end_time: text("end_time"), programme: text("programme") || undefined });
  };
  const text = (name, label, hint) => html`<div class="field"><label for=${name}>${label}</label><div class="in"><input id=${name} name=${name} defaultValue=${begin?.[name] ?? ""} required=${name !== "programme"} list=${name === "device_name" ? "cameras" : null} /></div>${hint && html`<small>${hint}</small>`}</div>`;
  const title = row ? "Change a row" : "Add a row";
  return html`<${Dialog} label=${title} close=${close}><h2>${title}</h2>
    <${Loaded} of=${actions} what="The list of actions">${(list) => (chosen.value === null ? html`<${Choice} list=${list} template=${(one) => template(one, list)} onChoose=${(name) => { chosen.value = name; }} /><div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button></div>`
      : html`<form ref=${form} key=${chosen.value} class="stack" onSubmit=${send} data-testid="row-form"><div class="field"><label for="action_type">Action</label><div class="in"><select id="action_type" data-first value=${chosen.value} onChange=${(event) => { chosen.value = event.target.value; }}>${[...new Set([...list.map((one) => one.name), chosen.value])].map((name) => html`<option key=${name} selected=${name === chosen.value}>${name}</option>`)}</select></div><small>${action?.help ?? ""}${action?.needs_safe_sky ? " Needs a safe sky." : ""}</small></div>
        <div class="grid g2">${text("device_name", "Camera", null)}${text("programme", "Programme", "May be left empty.")}${text("start_time", "From, UTC", null)}${text("end_time", "Until, UTC", null)}</div><datalist id="cameras">${cameras.map((camera) => html`<option key=${camera} value=${camera} />`)}</datalist>
        <${Parameters} schema=${action?.schema} value=${begin?.action_value ?? {}} filters=${filters} />
        <div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button><button class="btn main">${row ? "Change the line" : "Put it into the draft"}</button></div></form>`)}<//><//>`;
}
