// The users of this server: an engineer of all telescopes makes and changes them, and everybody their own password. What gives more is held, what takes away is confirmed.
import { html, useRef, useSignal } from "../lib.js";
import { ask, useGet } from "../api.js";
import { act } from "../close.js";
import { duration } from "../format.js";
import { Card, Dialog, Empty, Loaded, Table } from "../parts.js";
import { net } from "../store.js";
import { RIGHTS, isEngineer, isWithin, me, split } from "../user.js";
import { HoldButton } from "./controls.js";

const LADDER = Object.keys(RIGHTS);
const address = (name) => `/api/v1/users/${encodeURIComponent(name)}`;
const put = (path, body, headers = {}) => ask(path, { method: "PUT", headers: { "Content-Type": "application/json", ...headers }, body: JSON.stringify(body) });
const joined = ({ right, where }) => (where ? `${right}:${where}` : right);
const inWords = (where) => (where === "" ? "all telescopes" : where.endsWith("/*") ? `all of ${where.slice(0, -2)}` : where);

/** Grants as rows that are chosen; where nothing but all telescopes is known, there is nothing else to choose. */
function Rights({ grants }) {
  const ids = [...net.value.keys()];
  const places = [...new Set(["", ...ids.map((id) => `${id.split("/")[0]}/*`), ...ids, ...grants.value.map((grant) => split(grant).where)])].sort();
  const set = (i, part) => { grants.value = grants.value.map((grant, j) => (i === j ? joined({ ...split(grant), ...part }) : grant)); };
  return html`<fieldset class="field" data-testid="rights"><legend>May</legend>${grants.value.map((grant, i) => { const { right, where } = split(grant); return html`<div class="row" key=${i}>
      <label class="in"><select aria-label="Right" value=${right} onChange=${(event) => set(i, { right: event.target.value })}>${LADDER.map((one) => html`<option key=${one} selected=${one === right}>${one}</option>`)}</select></label>
      <label class="in grow"><select aria-label="At" value=${where} onChange=${(event) => set(i, { where: event.target.value })}>${places.map((place) => html`<option key=${place} value=${place} selected=${place === where}>${inWords(place)}</option>`)}</select></label>
      ${grants.value.length > 1 && html`<button type="button" class="btn sm soft" aria-label=${`Without ${grant}`} onClick=${() => { grants.value = grants.value.filter((_, j) => i !== j); }}>Without</button>`}</div>`; })}
    <div><button type="button" class="btn sm soft" onClick=${() => { grants.value = [...grants.value, "viewer"]; }}>One more right</button></div></fieldset>`;
}

/** A password is typed twice, because nobody sees it. */
const Password = ({ id = "password", name = "Password", required = true }) => html`<div class="field"><label for=${id}>${name}</label><div class="in"><input id=${id} name=${id} type="password" required=${required} minlength="12" autocomplete="new-password" /></div><small>12 characters or more; several words are easy to keep in mind.${required ? "" : " Left empty, the proxy alone lets this user in."}</small></div>
  <div class="field"><label for="again">The same again</label><div class="in"><input id="again" name="again" type="password" required=${required} autocomplete="new-password" /></div></div>`;

/** A dialog about users: what it asks for, and why the server refused. `send(data)` does it; `held` where it gives more. */
function Ask({ title, verb, held, send, done, close, children }) {
  const form = useRef(null);
  const problem = useSignal(null);
  const submit = async () => {
    if (!form.current.reportValidity()) return;
    const data = Object.fromEntries(new FormData(form.current));
    if ("again" in data && data.again !== (data.password ?? data.new_password)) {
      problem.value = "The two passwords differ: type the same twice.";
      return;
    }
    try {
      await send(data);
      close();
      done();
    } catch (error) {
      problem.value = error.message;
    }
  };
  return html`<${Dialog} label=${title} close=${close}><h2>${title}</h2><form ref=${form} class="stack" onSubmit=${(event) => { event.preventDefault(); if (!held) submit(); }}>${children}
    ${problem.value && html`<div class="note p2" role="alert"><span class="grow">${problem.value}</span></div>`}
    <div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button>${held ? html`<${HoldButton} text=${`Hold to ${verb.toLowerCase()}`} onDone=${submit} />` : html`<button class="btn main">${verb}</button>`}</div></form><//>`;
}

function NewUser({ first, close, done }) {
  const grants = useSignal([first ? "engineer" : "viewer"]);
  const send = ({ name, password }) => put(address(name), { rights: grants.value, ...(password && { password }) }, { "If-None-Match": "*" });
  return html`<${Ask} title=${first ? "Add the first user" : "Add a user"} verb="Add" held send=${send} done=${done} close=${close}>
    <div class="field"><label for="user">Name</label><div class="in"><input id="user" name="name" data-first required maxlength="63" autocomplete="off" autocapitalize="none" spellcheck=${false} /></div><small>Letters, digits, _, - or .</small></div>
    ${first ? html`<p>The first user is an <b>engineer</b> of all telescopes, who makes the others. From then on everybody has to log in, also on this host.</p>` : html`<${Rights} grants=${grants} />`}<${Password} required=${me.value?.way !== "proxy"} /><//>`;
}

function NewRights({ user, close, done }) {
  const grants = useSignal(user.rights);
  const more = grants.value.filter((grant) => !isWithin(grant, user.rights));
  return html`<${Ask} title=${`Change the rights of ${user.name}`} verb="Change" held=${more.length > 0} send=${() => put(address(user.name), { rights: grants.value })} done=${done} close=${close}>
    <${Rights} grants=${grants} /><p class="m">${more.length ? `Gives ${user.name} more: ${more.join(", ")}.` : `Gives ${user.name} nothing that is not given now.`} It counts from the next request on; nobody has to log in again.</p><//>`;
}

const NewPassword = ({ user, close, done }) => html`<${Ask} title=${`Another password for ${user.name}`} verb="Set" held send=${({ password }) => put(address(user.name), { password })} done=${done} close=${close}>
  <p class="m">All sessions of ${user.name} end. Tokens stay: remove those that others may know.</p><${Password} /><//>`;

/** Gives oneself another password, by the old one. */
export const OwnPassword = ({ close }) => html`<${Ask} title="Change your password" verb="Change" send=${({ old_password, new_password }) => put("/api/v1/me/password", { old_password, new_password })} done=${() => location.reload()} close=${close}>
  <p class="m">All your sessions end, this one too: log in with the new password.</p><div class="field"><label for="old">The old one</label><div class="in"><input id="old" name="old_password" type="password" data-first required autocomplete="current-password" /></div></div><${Password} id="new_password" name="The new one" /><//>`;

const COLUMNS = [{ key: "u", name: "User", sort: (one) => one.name }, { key: "r", name: "May" }, { key: "s", name: "Logged in" }, { key: "t", name: "For programs", num: true }, { key: "x", name: "" }];

function List() {
  const found = useGet("/api/v1/users", 30);
  const asked = useSignal(null);
  const close = () => { asked.value = null; };
  const open = (what, user) => () => { asked.value = { what, user }; };
  // Who is concerned may be oneself: the page asks again who one is, or is the login page then.
  const done = (user) => (found.data?.open || user?.name === me.value?.name ? location.reload() : found.again());
  const remove = ({ name }) => { close(); act(`${name} is removed, and logged out.`, () => ask(address(name), { method: "DELETE" }), () => done({ name })); };
  const { what, user } = asked.value ?? {};
  const first = found.data?.open;
  return html`<${Card} name="Users" flush testid="users" end=${html`<button class="btn sm soft" disabled=${!found.data} onClick=${open("add")}>${first ? "Add the first user …" : "Add a user …"}</button>`}><${Loaded} of=${found} what="The list of users">${({ items = [] }) => (items.length ? html`<${Table} label="Users" cls="cards" columns=${COLUMNS} rows=${items} keyOf=${(one) => one.name} rowProps=${(one) => ({ "data-user": one.name })}
      cells=${(one) => html`<td class="k">${one.name}${one.name === me.value?.name ? html` <span class="mm">you</span>` : ""}</td><td class="full">${one.rights.join(", ")}</td><td>${one.sessions ? `in ${one.sessions} browser${one.sessions > 1 ? "s" : ""}, idle ${duration(one.idle_s)}` : html`<span class="m">not logged in</span>`}</td><td class="num">${one.tokens}<span class="mm"> token${one.tokens === 1 ? "" : "s"}</span></td>
        <td class="full"><div class="row wrap"><button class="btn sm soft" aria-label=${`Rights of ${one.name}`} onClick=${open("rights", one)}>Rights …</button><button class="btn sm soft" aria-label=${`Password of ${one.name}`} onClick=${open("password", one)}>Password …</button><button class="btn sm soft" aria-label=${`Remove ${one.name}`} onClick=${open("remove", one)}>Remove …</button></div></td>`} />`
    : html`<${Empty} icon="lock" title="No user">${first ? "Nobody is asked here: every program of this host may do everything, and nobody beyond it sees the page." : "Nobody can log in; the proxy in front of this server lets people in."}<//>`)}<//>
    ${what === "add" && html`<${NewUser} first=${first} close=${close} done=${done} />`}
    ${what === "rights" && html`<${NewRights} key=${user.name} user=${user} close=${close} done=${() => done(user)} />`}
    ${what === "password" && html`<${NewPassword} user=${user} close=${close} done=${() => done(user)} />`}
    ${what === "remove" && html`<${Dialog} label=${`Remove ${user.name}`} close=${close}><h2>Remove ${user.name}?</h2><p class="m">${user.name} is logged out, and ${user.tokens ? `the tokens of ${user.name} (${user.tokens}) are removed: what uses them is refused from now on` : "has no tokens"}.</p><div class="acts"><button type="button" class="btn soft" onClick=${close}>Cancel</button><button type="button" class="btn main" data-first onClick=${() => remove(user)}>Remove</button></div><//>`}<//>`;
}

/** The list for those who may change it. */
export const Users = () => (isEngineer() ? html`<${List} />` : null);
