// Every active alert, the most urgent first: cause, consequence, what to do, and since when.
import { html, useSignal } from "../lib.js";
import { command } from "../api.js";
import { CameBack } from "../cameback.js";
import { CloseButton, note } from "../close.js";
import { clock, duration } from "../format.js";
import { Card, Counts, Dialog, Empty, Guard, Priority, PRIORITIES, Segment, fate, isCalm, priorityNumber } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { link, net, skyNow, tick, useTopic } from "../store.js";
import { worst } from "../shell.js";
import { may } from "../user.js";
import { Webcams } from "../webcams.js";

/** Words of an alert's kind: `dome-not-closed/dome` is "Dome not closed". */
export const kindWords = (id) => { const kind = id.split("/")[0].replaceAll("-", " "); return kind[0].toUpperCase() + kind.slice(1); };

function since(utc) {
  const now = skyNow();
  return now === null ? clock(utc) : `${clock(utc)}, ${duration((now - Date.parse(utc)) / 1000)} ago`;
}

async function order(telescope, name, parameters, reason, done) {
  const say = note(`${telescope}: ${name} is being sent …`, true);
  try {
    const state = await command(telescope, name, { ...parameters, reason, waitS: 5 });
    say(`${telescope}: ${name} ${state.state}${state.detail ? `: ${state.detail}` : ""}`);
    done?.();
  } catch (error) {
    say(`${telescope}: ${name} was not taken: ${error.message}`);
  }
}

function Shelve({ alert, close }) {
  const reason = useSignal("");
  const minutes = useSignal("60");
  const send = (event) => {
    event.preventDefault();
    order(alert.telescope, "shelve", { alert: alert.id, for_min: Number(minutes.value) }, reason.value, close);
  };
  return html`<${Dialog} label="Shelve an alert" close=${close}><h2>Shelve ${kindWords(alert.id)}?</h2><p class="m">It is sent to nobody for a while. It stays in this list, and in the log.</p>
    <form class="stack" onSubmit=${send}><div class="field"><label for="reason">Why</label><div class="in"><input id="reason" data-first required maxlength="500" onInput=${(event) => { reason.value = event.target.value; }} /></div></div>
      <div class="field"><label for="minutes">For</label><div class="in"><input id="minutes" type="number" min="1" max="1440" defaultValue="60" required onInput=${(event) => { minutes.value = event.target.value; }} /><span class="u">min</span></div></div>
      <div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button><button class="btn main">Shelve</button></div></form><//>`;
}

function Alert({ alert }) {
  const shelving = useSignal(false);
  const n = priorityNumber(alert.priority);
  const telescope = net.value.get(alert.telescope);
  const calm = isCalm(alert);
  const [answers, offline] = [may("operator", alert.telescope), link.value !== "live"];
  return html`<article class=${`alert p${n} ${calm ? "calm" : ""}`} data-testid="alert" data-alert=${alert.id} data-priority=${alert.priority}><div><${Priority} word=${alert.priority} off=${calm} /></div>
    <div class="body"><div class="t">${kindWords(alert.id)}</div><div class="w"><a href=${`/t/${alert.telescope}`}>${alert.telescope}</a> <span class="mono mm">${alert.id}</span></div>
      ${calm ? html`<div class="m">${alert.cause} ${fate(alert)}.</div>` : html`<dl><dt>Cause</dt><dd>${alert.cause}</dd><dt>Consequence</dt><dd>${alert.consequence}</dd><dt>Do</dt><dd><b>${alert.action}</b></dd></dl>`}<${CameBack} alert=${alert} id=${alert.telescope} /></div>
    <div class="due">raised ${since(alert.raised_utc)}</div>
    <div class="row wrap go">${n <= 2 && !calm && telescope && !telescope.shared && html`<${CloseButton} id=${alert.telescope} filled=${n === 1} cls=${worst()?.summary.id === alert.telescope ? "desk" : ""} />`}
      ${answers && !alert.acknowledged_by && html`<button type="button" class="btn soft" disabled=${offline} onClick=${() => order(alert.telescope, "ack", { alert: alert.id }, "")}>Acknowledge</button>`}
      ${answers && !calm && html`<button type="button" class="btn quiet" disabled=${offline} onClick=${() => { shelving.value = true; }}>Shelve</button>`}
      <a class="btn quiet" href=${`/t/${alert.telescope}/log?at=${encodeURIComponent(alert.raised_utc)}`}>Log of that minute</a>${answers && offline && html`<span class="why">No link to the server: nothing can be ordered.</span>`}</div>
    ${shelving.value && html`<${Shelve} alert=${alert} close=${() => { shelving.value = false; }} />`}</article>`;
}

/** So many alerts of one kind are one line, unless they are critical: a flood hides nothing else. */
const MANY = 4;

function List({ alerts }) {
  const kindOf = (alert) => (alert.priority === "critical" ? null : `${alert.priority} ${alert.id.split("/")[0]}`);
  const kinds = new Map();
  for (const alert of alerts) kinds.set(kindOf(alert), [...(kinds.get(kindOf(alert)) ?? []), alert]);
  return alerts.map((alert) => {
    const same = kindOf(alert) && kinds.get(kindOf(alert));
    if (!same || same.length < MANY) return html`<${Alert} key=${`${alert.telescope} ${alert.id}`} alert=${alert} />`;
    return same[0] === alert && html`<details class="alerts" key=${kindOf(alert)} data-testid="alert-kind"><summary><${Priority} word=${alert.priority} /> <b>${same.length} alerts: ${kindWords(alert.id)}</b> <span class="m">${[...new Set(same.map((one) => one.telescope))].join(", ")}</span></summary>
      ${same.map((one) => html`<${Alert} key=${`${one.telescope} ${one.id}`} alert=${one} />`)}</details>`;
  });
}

export function Alerts() {
  tick.value; // eslint-disable-line no-unused-expressions
  const items = useTopic("alerts");
  const asked = route.value.query.get("least");
  const least = ["medium", "high"].includes(asked) ? asked : "advisory";
  const all = [...(items?.values() ?? [])].sort((a, b) => priorityNumber(a.priority) - priorityNumber(b.priority) || (a.raised_utc < b.raised_utc ? 1 : -1));
  const chosen = all.filter((alert) => priorityNumber(alert.priority) <= priorityNumber(least));
  const counts = Object.fromEntries(PRIORITIES.map((word) => [word, all.filter((alert) => alert.priority === word && !isCalm(alert)).length]));
  // A camera does not depend on what failed: it shows whether the dome is open.
  const called = [...new Set(all.filter((alert) => !isCalm(alert) && priorityNumber(alert.priority) <= 2).map((alert) => String(alert.telescope)))].map((id) => id.split("/")).map(([site, telescope]) => ({ site, telescope }));
  const [active, calm] = [chosen.filter((alert) => !isCalm(alert)), chosen.filter(isCalm)];
  return html`<div class="page-h"><h1 tabindex="-1">Alerts</h1><span class="counts"><${Counts} counts=${counts} /></span><span class="grow"></span>
      <${Segment} label="Least priority" options=${[["advisory", "All"], ["medium", "Medium and up"], ["high", "High and up"]]} value=${least} onChange=${(value) => go(withQuery({ least: value === "advisory" ? null : value }), { replace: true })} /></div>
    ${!items ? html`<p class="m">${link.value === "live" ? "Reading alerts …" : "Connecting …"}</p>` : html`
      <div class="beside"><section class="card flush" aria-label="Active alerts">${active.length ? html`<${List} alerts=${active} />` : html`<${Empty} icon="check" title="Nothing is wrong that a person must see to" />`}</section>
        ${called.length > 0 && html`<${Guard} name="Webcams"><${Webcams} of=${called} /><//>`}</div>
      ${calm.length > 0 && html`<${Card} name="Returned, acknowledged and shelved" flush end="nobody is being called">${calm.map((alert) => html`<${Alert} key=${`${alert.telescope} ${alert.id}`} alert=${alert} />`)}<//>`}`}`;
}
