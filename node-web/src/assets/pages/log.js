// Log lines of one telescope or of all: live, filtered by text and level, or the lines around a moment.
import { html, useSignal } from "../lib.js";
import { useGet } from "../api.js";
import { clock } from "../format.js";
import { Card, Empty, Icon, Loaded, Segment } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { net, useTopic } from "../store.js";

const LEVELS = ["error", "warn", "info", "debug"];
const SHAPE = { error: "1", warn: "2" };
const AROUND_S = 120;

/** Ids are long and alike: their end tells them apart. */
const shorter = (value) => (/^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$/.test(value) ? `…${String(value).slice(-8)}` : value);
const millis = (utc) => { const time = new Date(utc); return Number.isNaN(time.getTime()) ? "?" : time.toISOString().slice(11, 23); };
const fieldsOf = (line) => (typeof line.fields === "object" && line.fields ? Object.entries(line.fields).map(([name, value]) => `${name}=${shorter(value)}`).join(" ") : "");

/** Lines that repeat each other are one, with their number. */
function folded(lines) {
  const out = [];
  for (const line of lines) {
    const last = out[out.length - 1];
    if (last && last.message === line.message && last.node === line.node && last.level === line.level && fieldsOf(last) === fieldsOf(line)) last.times += 1;
    else out.push({ ...line, times: 1 });
  }
  return out;
}

function Lines({ lines, here, follow }) {
  if (!lines.length) return html`<${Empty} icon="log" title="No lines">None was written, or none fits the search.<//>`;
  return html`<ul class="log" tabindex="0" aria-label="Log lines, newest first" data-testid="lines" data-count=${lines.length}>${folded(lines).map((line) => html`<li key=${`${line.at_utc} ${line.number ?? ""} ${line.message}`} data-l=${line.level} class=${here && Math.abs(Date.parse(line.at_utc) - here) < 1000 ? "here" : ""}>
    <time datetime=${line.at_utc}>${millis(line.at_utc)}</time><span class="lv">${SHAPE[line.level] && html`<svg class="sh" aria-hidden="true"><use href=${`#sh${SHAPE[line.level]}`} /></svg> `}${String(line.level).toUpperCase()}</span>
    <span class="src cut">${line.telescope ?? ""}</span><span class="src cut">${line.node}</span><span class="msg cut" title=${`${line.message} ${fieldsOf(line)}`}>${line.message} <span class="f">${fieldsOf(line)}</span></span><span>${line.times > 1 && html`<span class="fold">×${line.times}</span>`}${!follow && html`<a class="quiet" href=${withQuery({ at: line.at_utc })} aria-label="Lines around this one"><${Icon} name="clock" /></a>`}</span></li>`)}</ul>`;
}

/** Those that fit the level and the text. */
const fitting = (lines, level, text) => lines.filter((line) => LEVELS.indexOf(line.level) <= LEVELS.indexOf(level) && `${line.message} ${line.node} ${line.telescope ?? ""} ${fieldsOf(line)}`.toLowerCase().includes(text.toLowerCase()));

function Live({ id, level, text }) {
  const lines = useTopic(`log${id ? `?telescope=${id}` : ""}`);
  if (!lines) return html`<p class="m">Reading the log …</p>`;
  const shown = fitting(lines, level, text);
  return html`<${Card} name="Live" flush end=${`${shown.length} of ${lines.length} lines`}><${Lines} lines=${shown.slice(0, 300)} /><//>`;
}

/** The lines around a moment, from the archive. */
function Around({ id, at, level, text }) {
  const moment = Date.parse(at);
  const span = useSignal(AROUND_S);
  const stamp = (ms) => new Date(ms).toISOString();
  const found = useGet(`/api/v1/telescopes/${id}/log?from_utc=${stamp(moment - span.value * 1000)}&to_utc=${stamp(moment + span.value * 1000)}&limit=2000`);
  return html`<${Card} name=${`Around ${clock(at)}`} flush end=${html`<${Segment} label="How far" options=${[[AROUND_S, "± 2 min"], [600, "± 10 min"], [3600, "± 1 h"]]} value=${span.value} onChange=${(value) => { span.value = value; }} /> <a class="btn sm soft" href=${withQuery({ at: null })}>Live</a>`}>
    <${Loaded} of=${found} what="The log">${(data) => {
      const lines = (data.rows ?? []).map((row) => row.log).filter(Boolean).reverse();
      return html`${data.truncated && html`<p class="note p3">There are more lines than are shown: choose a shorter time.</p>`}<${Lines} lines=${fitting(lines, level, text)} here=${moment} follow />`;
    }}<//><//>`;
}

export function Log({ id }) {
  const { query } = route.value;
  const level = useSignal(query.get("level") ?? "info");
  const text = useSignal(query.get("text") ?? "");
  const at = query.get("at");
  const chosen = id ?? query.get("telescope");
  const telescopes = [...net.value.values()];
  return html`<div class="page-h">${id ? html`<h2>Log</h2>` : html`<h1 tabindex="-1">Log</h1>`}</div>
    <div class="row wrap chips-x"><label class="in"><${Icon} name="search" /><input type="search" placeholder="Text, field or id" aria-label="Search the log" value=${text.value} onInput=${(event) => { text.value = event.target.value; }} /><kbd>/</kbd></label>
      <${Segment} label="Level" options=${[["debug", "All"], ["info", "Info and up"], ["warn", "Warn and up"], ["error", "Error"]]} value=${level.value} onChange=${(value) => { level.value = value; }} />
      ${!id && html`<label class="in"><select aria-label="Telescope" onChange=${(event) => go(withQuery({ telescope: event.target.value || null, at: null }), { replace: true })}><option value="">All telescopes</option>${telescopes.map((one) => html`<option key=${one.id} value=${one.id} selected=${one.id === chosen}>${one.id}</option>`)}</select></label>`}
      <span class="grow"></span><span class="tagline desk">UTC, newest first${at ? "" : `, live`}</span></div>
    ${at && chosen ? html`<${Around} id=${chosen} at=${at} level=${level.value} text=${text.value} />` : html`<${Live} id=${chosen} level=${level.value} text=${text.value} />`}`;
}
