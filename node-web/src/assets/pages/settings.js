// Who you are and what you may do, the sessions and tokens that are open, and what this browser keeps.
import { html, useSignal } from "../lib.js";
import { ask, useGet } from "../api.js";
import { act } from "../close.js";
import { clock, day, duration } from "../format.js";
import { Card, Dialog, Empty, Loaded, Segment, Table } from "../parts.js";
import { choose, density, theme } from "../look.js";
import { forgetPicture } from "../picture.js";
import { DeviceAlerts } from "../push.js";
import { RIGHTS, grantText, isEngineer, leave, me, split } from "../user.js";
import { OwnPassword, Users } from "./users.js";

const WAYS = { session: "by a password in this browser", token: "by a token", proxy: "by the proxy in front of this server", open: "nobody is asked here: only programs of this host reach the page" };
const date = (utc) => `${day(utc)} ${clock(utc)}`;

function Messages() {
  const sent = useSignal(null);
  const sending = useSignal(false);
  const send = async () => {
    sending.value = true;
    try {
      sent.value = await ask("/api/v1/alerts/test", { method: "POST" });
    } catch (error) {
      sent.value = { problem: error.message };
    }
    sending.value = false;
  };
  const { problem, receivers = [], telescope } = sent.value ?? {};
  const result = problem ? html`<p class="note p2" role="alert"><span class="grow">${problem}</span></p>`
    : receivers.length ? html`<ul class="list" role="status">${receivers.map((one) => html`<li key=${one.name}><b>${one.name}</b> <span class="m">${one.way}</span> ${one.error ? html`<span class="ink-p2">not sent: ${one.error}</span>` : "taken by its server: look whether it arrives"}</li>`)}</ul>`
      : html`<p class="note p2" role="status"><span class="grow"><b>Nobody is told of alerts of ${telescope}.</b> [alerts] of its file names no receiver, and no browser gets them.</span></p>`;
  return html`<${Card} name="Messages to people" testid="messages" end=${html`<button class="btn sm soft" disabled=${sending.value} onClick=${send}>${sending.value ? "Sending …" : "Send a test message"}</button>`}>
    <p class="m">Alerts go to telephones and mailboxes by [alerts] of the file of this server's telescope, and to browsers where they are switched on. A test message goes to all of them, and says that nothing is wrong.</p>${sent.value && result}<//>`;
}

function You() {
  const who = me.value;
  const changing = useSignal(false);
  if (!who) return html`<${Card} name="You"><p class="m">Asking …</p><//>`;
  return html`<${Card} name="You" end=${who.way === "session" && html`<button class="btn sm soft" onClick=${() => { changing.value = true; }}>Password …</button> <button class="btn sm soft" onClick=${leave}>Log out</button>`} testid="you"><div class="row base wrap"><span class="big">${who.name}</span><span class="m">${WAYS[who.way] ?? who.way}${who.session_ends_utc ? `, until ${date(who.session_ends_utc)} at the latest` : ""}</span></div>
    <dl class="kv">${(who.rights ?? []).map((one) => { const { right, where } = split(one); return [html`<dt key=${`${one}t`}><b>${right}</b></dt>`, html`<dd key=${`${one}d`}>${where ? `of ${where}` : "of all telescopes"} <span class="m">${RIGHTS[right] ?? ""}</span></dd>`]; })}</dl>
    ${who.insecure_open && html`<p class="note p2"><span class="grow"><b>This server is open to everybody.</b> Make users: <code>starmesh user add</code>.</span></p>`}
    ${changing.value && html`<${OwnPassword} close=${() => { changing.value = false; }} />`}<//>`;
}

function Browser() {
  return html`<${Card} name="This browser"><div class="stack"><div class="row wrap between"><span>Theme</span><${Segment} label="Theme" options=${[["dark", "Dark"], ["night", "Night"], ["light", "Light"]]} value=${theme.value} onChange=${(value) => choose("theme", value)} /></div>
    <div class="row wrap between"><span>Density</span><${Segment} label="Density" options=${[["compact", "Compact"], ["roomy", "Roomy"]]} value=${density.value} onChange=${(value) => choose("density", value)} /></div>
    <div class="row wrap between"><span>Last picture <span class="m">shown, as old, when the server does not answer</span></span><button class="btn sm soft" onClick=${() => act("The last picture is removed. It is kept again from the next time that this page is loaded.", forgetPicture, () => {})}>Remove</button></div></div><//>`;
}

function Sessions() {
  const found = useGet("/api/v1/sessions", 30);
  const end = (one) => act(`The session of ${one.user} is ended.`, () => ask(`/api/v1/sessions/${encodeURIComponent(one.id)}`, { method: "DELETE" }), one.current ? () => location.reload() : found.again);
  return html`<${Card} name="Sessions" flush testid="sessions"><${Loaded} of=${found} what="The list of sessions">${({ items = [] }) => (items.length ? html`<${Table} label="Sessions" columns=${[{ key: "u", name: "User" }, { key: "a", name: "From" }, { key: "b", name: "Since" }, { key: "i", name: "Idle", num: true }, { key: "x", name: "" }]} rows=${items} keyOf=${(one) => one.id}
    cells=${(one) => html`<td class="k">${one.user}${one.current ? html` <span class="mm">this browser</span>` : ""}</td><td class="mono mm">${one.address}</td><td>${date(one.began_utc)}</td><td class="num">${duration(one.idle_s)}</td><td class="num"><button class="btn sm soft" aria-label=${`End the session of ${one.user} from ${one.address}`} onClick=${() => end(one)}>End</button></td>`} />` : html`<${Empty} icon="lock" title="No session">Nobody has logged in with a password.<//>`)}<//><//>`;
}

function NewToken({ close, again }) {
  const made = useSignal(null);
  const problem = useSignal(null);
  const own = [...new Set((me.value?.rights ?? []).map(grantText))];
  const send = async (event) => {
    event.preventDefault();
    const data = new FormData(event.target);
    const rights = data.getAll("rights").map(String);
    try {
      made.value = await ask("/api/v1/tokens", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ name: data.get("name"), days: Number(data.get("days")), ...(rights.length && { rights }) }) });
      again();
    } catch (error) {
      problem.value = error;
    }
  };
  const choices = [...new Set([...own, ...(own.length ? ["viewer"] : [])])];
  return html`<${Dialog} label="Make a token" close=${close}><h2>Make a token</h2>${made.value ? html`<p>It is shown this once. Keep it like a password.</p><p class="code pad mono pre" data-testid="token">${made.value.token}</p><p class="m">For a program: <code>Authorization: Bearer …</code>. It acts for ${made.value.user} until ${date(made.value.expires_utc)}.</p><div class="acts"><button type="button" class="btn main" data-first onClick=${close}>Done</button></div>`
    : html`<form class="stack" onSubmit=${send}><div class="field"><label for="name">What it is for</label><div class="in"><input id="name" name="name" data-first required maxlength="63" placeholder="cron" autocomplete="off" /></div></div><div class="field"><label for="days">Good for</label><div class="in"><input id="days" name="days" type="number" min="1" max="3650" defaultValue="90" required /><span class="u">days</span></div></div>
      <fieldset class="field"><legend>May</legend>${choices.map((right) => html`<label class="check" key=${right}><input type="checkbox" name="rights" value=${right} defaultChecked=${right === "viewer"} /> ${right}</label>`)}<small>Nothing chosen: all that you may.</small></fieldset>
      ${problem.value && html`<div class="note p2" role="alert"><span class="grow">${problem.value.message}</span></div>`}<div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button><button class="btn main">Make</button></div></form>`}<//>`;
}

function Tokens() {
  const found = useGet("/api/v1/tokens", 30);
  const making = useSignal(false);
  const removing = useSignal(null);
  const may = me.value?.way === "session" || me.value?.way === "proxy";
  const remove = (one) => { removing.value = null; act(`The token ${one.name} is removed, and refused from now on.`, () => ask(`/api/v1/tokens/${encodeURIComponent(one.name)}`, { method: "DELETE" }), found.again); };
  return html`<${Card} name="Tokens for programs" flush testid="tokens" end=${html`<button class="btn sm soft" disabled=${!may} title=${may ? null : "A token belongs to a user who has logged in."} onClick=${() => { making.value = true; }}>Make a token …</button>`}><${Loaded} of=${found} what="The list of tokens">${({ items = [] }) => (items.length ? html`<${Table} label="Tokens" columns=${[{ key: "n", name: "Token" }, { key: "u", name: "Acts for" }, { key: "r", name: "May" }, { key: "e", name: "Until" }, { key: "x", name: "" }]} rows=${items} keyOf=${(one) => one.name}
      cells=${(one) => html`<td class="k">${one.name}</td><td>${one.user}</td><td>${one.rights ? one.rights.map(grantText).join(", ") : "all that its user may"}</td><td>${date(one.expires_utc)}</td><td class="num"><button class="btn sm soft" onClick=${() => { removing.value = one; }}>Remove …</button></td>`} />` : html`<${Empty} icon="lock" title="No token">${may ? "Make one for a script that reads the API." : "Tokens belong to users; here nobody has logged in."}<//>`)}<//>
    ${making.value && html`<${NewToken} close=${() => { making.value = false; }} again=${found.again} />`}
    ${removing.value && html`<${Dialog} label="Remove a token" close=${() => { removing.value = null; }}><h2>Remove the token ${removing.value.name}?</h2><p class="m">Whatever uses it is refused from now on.</p><div class="acts"><button type="button" class="btn soft" onClick=${() => { removing.value = null; }}>Cancel</button><button type="button" class="btn main" data-first onClick=${() => remove(removing.value)}>Remove</button></div><//>`}<//>`;
}

const Rights = () => html`<${Card} name="The four rights"><div class="stack"><dl class="kv">${Object.entries(RIGHTS).map(([right, may]) => [html`<dt key=${right}><b>${right}</b></dt>`, html`<dd key=${`${right}d`}>${may}</dd>`])}</dl><p class="m">A right is for all telescopes, for those of a site, or for one. ${isEngineer() ? html`On the server's host, <code>starmesh user</code> does the same as this page, and sets a password that was forgotten.` : "An engineer of all telescopes gives and takes rights."}</p></div><//>`;

export function Settings() {
  return html`<div class="page-h"><h1 tabindex="-1">Settings and users</h1></div><div class="grid g2"><div class="stack"><${You} /><${Browser} /><${Messages} /><${DeviceAlerts} /></div><${Rights} /></div><${Users} /><${Sessions} /><${Tokens} />`;
}
