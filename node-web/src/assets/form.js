// Fields made from a JSON Schema, for the parameters of orders and of rows, and what was written in them.
import { html } from "./lib.js";

/** A name of a schema or an order for people: `needs-safe_sky` is "Needs safe sky". */
export const title = (word) => { const plain = String(word).replaceAll(/[-_]/g, " "); return plain[0]?.toUpperCase() + plain.slice(1); };

/** The types of a schema that are not null. */
const typesOf = (schema) => [schema?.type].flat().filter((one) => one && one !== "null");
const isNumber = (schema) => { const types = typesOf(schema); return types.length > 0 && types.every((one) => one === "number" || one === "integer"); };
const isWritten = (schema) => !schema.enum && !isNumber(schema) && !["boolean", "string"].includes(typesOf(schema)[0]);

/** One field; `value` is what it begins with, and drawing the page anew leaves what was written since. What has parts is written as JSON. */
export function Field({ path, schema, required, value = schema.default }) {
  const described = schema.description ? `${path}-what` : null;
  const words = (schema.enum ?? []).filter((word) => word !== null);
  const what = schema.description && html`<small id=${described}>${schema.description}</small>`;
  if (typesOf(schema)[0] === "boolean") return html`<div class="field"><label class="check"><input id=${path} name=${path} type="checkbox" class="toggle" defaultChecked=${value === true} aria-describedby=${described} />${title(path)}</label>${what}</div>`;
  const input = words.length ? html`<select id=${path} name=${path} required=${required} aria-describedby=${described}>${!required && html`<option value="">—</option>`}${words.map((word) => html`<option key=${word} selected=${word === value}>${word}</option>`)}</select>`
    : isNumber(schema) ? html`<input id=${path} name=${path} type="number" step=${typesOf(schema).includes("number") ? "any" : 1} min=${schema.minimum} max=${schema.maximum} defaultValue=${value ?? ""} required=${required} aria-describedby=${described} />`
    : html`<input id=${path} name=${path} type="text" class=${isWritten(schema) ? "mono" : ""} placeholder=${isWritten(schema) ? (typesOf(schema)[0] === "array" ? "[…]" : "JSON") : null} defaultValue=${value === null || value === undefined ? "" : isWritten(schema) && typeof value !== "string" ? JSON.stringify(value) : value} required=${required} aria-describedby=${described} />`;
  return html`<div class="field"><label for=${path}>${title(path)}</label><div class="in">${input}${schema.unit && html`<span class="u">${schema.unit}</span>`}</div>${what}</div>`;
}

/** What a form says of the properties of a schema; what is empty is left out, and where `sparse` what is as its default, too. Text that is no JSON stays text. */
export function valuesOf(form, properties, sparse = false) {
  const data = new FormData(form);
  const out = {};
  for (const [path, schema] of properties) {
    const written = data.get(path);
    const value = typesOf(schema)[0] === "boolean" && !schema.enum ? written !== null : written === null || written === "" ? undefined : isNumber(schema) ? Number(written) : isWritten(schema) ? parsed(String(written)) : written;
    const usual = schema.default ?? (value === false ? false : undefined);
    if (value !== undefined && !(sparse && JSON.stringify(value) === JSON.stringify(usual))) out[path] = value;
  }
  return out;
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return text;
  }
}
