// Every order of a telescope: what it does, what stands against it now, and whether you may. What closes needs one confirmation; what opens or loosens is held.
import { html, useRef, useSignal } from "../lib.js";
import { ask, command, useGet } from "../api.js";
import { CloseButton, note } from "../close.js";
import { Field, title, valuesOf } from "../form.js";
import { clock, duration } from "../format.js";
import { Card, Dialog, Icon, Loaded, Table, standing } from "../parts.js";
import { link, skyAgeOf, tick, useTopic } from "../store.js";
import { Input, inputValue } from "../inputs.js";
import { me } from "../user.js";

const HOLD_MS = 1500;
/** Orders with a page of their own. */
const ELSEWHERE = new Set(["put-schedule", "skip", "repeat", "ack", "shelve", "unshelve"]);

/** A sentence in which names of orders stand between backticks. */
const Words = ({ text }) => String(text).split("`").map((part, i) => (i % 2 ? html`<span class="mono" key=${i}>${part}</span>` : part));

/** Sends nothing unless it is held to its end, by pointer or by key. */
export function HoldButton({ text, disabled, onDone, cls = "" }) {
  const on = useSignal(false);
  const timer = useRef(0);
  const begin = () => {
    if (disabled || timer.current) return;
    on.value = true;
    timer.current = setTimeout(() => { end(); onDone(); }, HOLD_MS);
  };
  const end = () => {
    clearTimeout(timer.current);
    timer.current = 0;
    on.value = false;
  };
  const key = (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    if (!event.repeat) begin();
  };
  return html`<button type="button" class=${`btn hold ${on.value ? "on" : ""} ${cls}`} disabled=${disabled} onPointerDown=${begin} onPointerUp=${end} onPointerLeave=${end} onPointerCancel=${end} onBlur=${end} onKeyDown=${key} onKeyUp=${end}><span>${text}</span></button>`;
}

/** What became of a given order, and what stood against it. */
const said = (one) => [one.detail, ...(one.against ?? [])].filter(Boolean).join("; ");

/** Follows an order to its end, in words. */
async function give(id, order, parameters, reason) {
  const say = note(`${id}: ${order} is being sent …`, true);
  try {
    let state = await command(id, order, { ...parameters, reason });
    for (let i = 0; i < 320 && ["sent", "accepted"].includes(state.state); i += 1) {
      say(`${id}: ${order} ${state.state}${said(state) ? `: ${said(state)}` : ""} …`, false);
      await new Promise((resolve) => { setTimeout(resolve, 1000); });
      state = await ask(`/api/v1/commands/${state.id}`);
    }
    say(`${id}: ${order} ${state.state}${said(state) ? `: ${said(state)}` : ""}`);
  } catch (error) {
    say(`${id}: ${order} was not taken: ${error.message}`);
  }
}

/** The dialog of an order; `preset` has the parameters that need no asking, and `about` names what they stand for. */
export function Order({ id, order, close, reload = () => {}, preset = {}, about = id.split("/")[1] }) {
  const form = useRef(null);
  const properties = Object.entries(order.parameters?.properties ?? {}).filter(([name]) => !(name in preset));
  const send = () => {
    if (!form.current.reportValidity()) return;
    const parameters = { ...preset, ...valuesOf(form.current, properties) };
    const reason = new FormData(form.current).get("reason") ?? "";
    close();
    give(id, order.command, parameters, reason).then(reload);
  };
  return html`<${Dialog} label=${`${title(order.command)} ${about}?`} close=${close}><h2>${title(order.command)} ${about}?</h2><p class="m"><${Words} text=${order.meaning} /></p>
    <form ref=${form} class="stack" onSubmit=${(event) => { event.preventDefault(); if (order.closes) send(); }}>${properties.map(([path, schema]) => html`<${Field} key=${path} path=${path} schema=${schema} required=${(order.parameters.required ?? []).includes(path)} />`)}
      <div class="field"><label for="reason">Why${order.needs_reason ? "" : " (may be left empty)"}</label><div class="in"><input id="reason" name="reason" maxlength="500" required=${order.needs_reason} data-first /></div></div>
      ${order.against.length > 0 && html`<ul class="locks">${order.against.map((text) => html`<li key=${text} class="no"><${Icon} name="x" /><span><${Words} text=${text} /></span></li>`)}</ul>`}
      <div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button>${order.closes ? html`<button class="btn close"><span>${title(order.command)}</span></button>` : html`<${HoldButton} text=${`Hold to ${order.command.replaceAll("-", " ")}`} onDone=${send} />`}</div></form><//>`;
}

function Group({ name, hint, orders, onChoose }) {
  if (!orders.length) return null;
  const offline = link.value !== "live";
  return html`<${Card} name=${name} end=${hint}><ul class="ctls">${orders.map((order) => html`<li class="ctl" key=${order.command} data-testid="order" data-order=${order.command}><div class="grow"><b>${title(order.command)}</b><div class="why"><${Words} text=${order.meaning} /></div>
    ${order.may && offline && html`<div class="why">No link to the server: nothing can be ordered.</div>`}${!order.may && html`<div class="why">You may not: it needs the right <b>${order.right}</b>.</div>`}${order.may && order.against.length > 0 && html`<div class="why">Now: <${Words} text=${order.against.join("; ")} />.</div>`}</div><button type="button" class="btn soft sm" disabled=${!order.may || offline} onClick=${() => onChoose(order)}>${title(order.command)} …</button></li>`)}</ul><//>`;
}

function MayOpen({ id }) {
  const states = useTopic(`tel/${id}/observatory/safety`);
  const entry = states?.get(`${id}/observatory/safety/state`);
  if (!entry) return html`<${Card} name="May the dome open?"><p class="m">No verdict received yet: no.</p><//>`;
  const { inputs = [], reasons = [] } = entry.body;
  const why = new Map(reasons.map((reason) => [reason.input, reason]));
  const left = entry.body.time_to_safe_s;
  return html`<${Card} name="May the dome open?" end=${entry.body.verdict === "safe" ? "yes" : html`<b class="ink-p2">no, ${reasons.length} of ${Math.max(inputs.length, reasons.length)}</b>`}><ul class="locks">${inputs.map((input) => html`<li key=${input.input} class=${why.has(input.input) ? "no" : ""}><${Icon} name=${why.has(input.input) ? "x" : "check"} /><${Input} input=${input.input} /><span class="v">${why.get(input.input)?.why ?? inputValue(input)}</span></li>`)}
    ${reasons.filter((reason) => !inputs.some((input) => input.input === reason.input)).map((reason) => html`<li key=${reason.input} class="no"><${Icon} name="x" /><${Input} input=${reason.input} /><span class="v">${reason.why}</span></li>`)}</ul>${left != null && entry.body.verdict !== "safe" && html`<p class="m">At the earliest in ${duration(Math.max(0, left - skyAgeOf(entry)))}.</p>`}<//>`;
}

export function Controls({ id, summary }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const catalogue = useGet(`/api/v1/telescopes/${id}/commands/catalog`, 10);
  const given = useGet(`/api/v1/commands?telescope=${encodeURIComponent(id)}&limit=10`, 5);
  const chosen = useSignal(null);
  const now = standing(summary);
  const orders = (catalogue.data ?? []).filter((order) => !ELSEWHERE.has(order.command) && order.command !== "close");
  const sky = new Set(["start", "open-again", "override"]);
  const choose = (order) => { chosen.value = order; };
  return html`<div class="grid g-side"><div class="stack"><${Card} name="Always available" end="towards safe: no unlock"><${CloseButton} id=${id} xl named cls="desk" /><p class="why">${now.posture === "closed" ? "It is closed now. Closing again does no harm." : `The dome is ${now.posture === "unknown" ? "in a state that nobody knows" : now.posture}.`}</p><//>
      <${Loaded} of=${catalogue} what="The list of orders">${() => html`<${Group} name="Towards safe" hint="one confirmation" orders=${orders.filter((order) => order.closes)} onChoose=${choose} /><${Group} name="Routine" hint="held for 1.5 s" orders=${orders.filter((order) => !order.closes && !sky.has(order.command))} onChoose=${choose} /><${Group} name="Towards the sky" hint="held for 1.5 s" orders=${orders.filter((order) => !order.closes && sky.has(order.command))} onChoose=${choose} />`}<//></div>
    <div class="stack"><${MayOpen} id=${id} /><${Card} name="Given orders" flush><${Loaded} of=${given} what="The list">${(list) => ((list.items ?? list).length ? html`<${Table} label="Given orders" columns=${[{ key: "o", name: "Order" }, { key: "b", name: "By" }, { key: "s", name: "State" }]} rows=${list.items ?? list} keyOf=${(one) => one.id} cells=${(one) => html`<td class="k">${one.command}</td><td>${one.requested_by}</td><td>${one.state}${said(one) ? html` <span class="m"><${Words} text=${said(one)} /></span>` : ""} <span class="mm">${one.events?.[0]?.at_utc ? clock(one.events[0].at_utc) : ""}</span></td>`} />` : html`<p class="m pad">None was given at this server.</p>`)}<//><//>
      <${Card} name="Who you are"><p>${me.value ? html`<b>${me.value.name}</b>, ${me.value.rights?.map((right) => (typeof right === "string" ? right : JSON.stringify(right))).join(", ") || "no rights"}` : "not known"}</p><//></div></div>
    ${chosen.value && html`<${Order} key=${chosen.value.command} id=${id} order=${chosen.value} close=${() => { chosen.value = null; }} reload=${() => { catalogue.again(); given.again(); }} />`}`;
}
