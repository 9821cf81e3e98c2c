// The schedule: rows of tonight and their forecast; a draft of the next one in its editor; and those that were in force, any of which can be brought back.
import { html, useEffect, useMemo, useSignal } from "../lib.js";
import { useGet, useReport } from "../api.js";
import { Changes } from "../changes.js";
import { base, draftOf, textAt } from "../draft.js";
import { useForecast } from "../forecast.js";
import { title } from "../form.js";
import { stateOf } from "../devices.js";
import { clock, day, hourMinute } from "../format.js";
import { Keys, Night, OldNight } from "../night.js";
import { Card, Loaded, Table } from "../parts.js";
import { Order } from "./controls.js";
import { difference } from "../rowtext.js";
import { siteOf, tonight } from "../site.js";
import { net, skyNow, tick, useTopic } from "../store.js";

const SHAPES = { pending: "·", running: "▶", interrupted: "‖", finished: "✓", failed: "✕", skipped: "–" };
const LISTED = 10;
/** As many as the server lists. */
const MOST_LISTED = 1000;

/** The orders that make sense about a row now. */
function ordersAbout(row) {
  const runsAgain = Date.parse(row.end_utc) > (skyNow() ?? 0) ? ["repeat"] : [];
  if (row.status === "interrupted") return ["skip", ...runsAgain];
  return ["pending", "running"].includes(row.status) ? ["skip"] : runsAgain;
}

function Rows({ id, rows, plan, sha256 }) {
  const orders = useGet(`/api/v1/telescopes/${id}/commands/catalog`, 60).data;
  /** While an order about a row is given: that order, the row, and the schedule in which it was seen. */
  const chosen = useSignal(null);
  const given = (row) => ordersAbout(row).map((command) => (Array.isArray(orders) ? orders.find((order) => order?.command === command && order.may) : null)).filter(Boolean);
  const forecast = new Map((plan?.rows ?? []).map((row) => [row.row, row]));
  const columns = [{ key: "r", name: "Row", num: true }, { key: "w", name: "What" }, { key: "t", name: "Window, UTC" }, { key: "f", name: "Frames", num: true }, { key: "s", name: "Status" }, { key: "p", name: "Forecast", cls: "hidep" }, { key: "o", name: "" }];
  return html`<${Table} label="Rows of tonight" cls="cards" columns=${columns} rows=${rows} keyOf=${(row) => row.row} rowProps=${(row) => ({ "data-testid": "schedule-row", "data-row": row.row, "data-status": row.status })} cells=${(row) => {
    const ahead = forecast.get(row.row);
    return html`<td class="num hidep">${row.row + 1}</td><td class="k"><span class="phone">${row.row + 1}. </span>${[row.action, row.object].filter(Boolean).join(" ")} <span class="mm">${row.camera ?? ""}</span></td><td>${hourMinute(row.start_utc)} – ${hourMinute(row.end_utc)}</td><td class="num">${row.frames || row.frames_wanted ? `${row.frames}${row.frames_wanted != null ? ` of ${row.frames_wanted}` : ""}` : ""}</td>
      <td class="wrap"><span aria-hidden="true">${SHAPES[row.status] ?? "?"}</span> ${row.status}${row.detail ? html` <span class="m">${row.detail}</span>` : ""}</td><td class="hidep m">${ahead && row.status !== "finished" ? `${hourMinute(ahead.start_utc)} to ${hourMinute(ahead.end_utc)}${ahead.frames_wanted ? `, ${ahead.frames} frames` : ""}${ahead.note ? `; ${ahead.note}` : ""}` : ""}</td>
      <td>${given(row).map((order) => html`<button key=${order.command} class="btn soft sm" aria-label=${`${title(order.command)} row ${row.row + 1}`} onClick=${() => { chosen.value = { order, row, of: sha256 }; }}>${title(order.command)} …</button>`)}</td>`;
  }} />
  ${chosen.value && html`<${Order} key=${`${chosen.value.order.command} ${chosen.value.row.row}`} id=${id} order=${chosen.value.order} about=${`row ${chosen.value.row.row + 1}, ${[chosen.value.row.action, chosen.value.row.object].filter(Boolean).join(" ")}`} preset=${{ number: chosen.value.row.row + 1, ...(chosen.value.of && { of: chosen.value.of }) }} close=${() => { chosen.value = null; }} />`}`;
}

/** A version of before: what would change if it took the place of what is in force, and the way back to it. */
function Version({ id, version, onBring }) {
  const found = useSignal(null);
  const problem = useSignal(null);
  const { version: number, author, at_utc: at, reason } = version;
  useEffect(() => {
    Promise.all([textAt(`${base(id)}/revisions/${number}`), textAt(base(id))]).then(([old, now]) => { found.value = { text: old.text, changes: difference(now.text, old.text) }; }, (error) => { problem.value = error; });
  }, [id, number]);
  return html`<${Card} name=${`Version ${number}`} label="The version that is looked at" testid="version" flush end=${`${day(at)} ${clock(at)}, ${author}${reason ? `: ${reason}` : ""}`}>
    ${problem.value ? html`<div class="note p2" role="alert"><span class="grow">${problem.value.message}</span></div>` : !found.value ? html`<p class="m pad">Reading version ${number} …</p>`
      : html`<p class="m pad">${found.value.changes.length ? "This would change if it took the place of what is in force:" : "It has the rows of what is in force."}</p><${Changes} label=${`Version ${number} compared with the schedule in force`} changes=${found.value.changes} />
        <div class="row wrap pad"><button class="btn soft" onClick=${() => onBring(found.value.text, number)}>Bring this one back …</button><span class="why">It becomes the draft. Nothing is in force until you activate that.</span></div>`}<//>`;
}

function Versions({ id, sha256, list, limit, onBring }) {
  const looked = useSignal(null);
  useEffect(() => { if (list.data) list.again(); }, [sha256]);
  return html`<${Card} name="Schedules that were in force" flush><${Loaded} of=${list} what="The list">${(all) => html`<${Table} label="Versions" cls="cards" columns=${[{ key: "v", name: "Version" }, { key: "t", name: "From" }, { key: "a", name: "By" }, { key: "r", name: "Why" }, { key: "n", name: "Rows", num: true }, { key: "d", name: "" }]} rows=${all} keyOf=${(one) => one.version} rowProps=${(one) => ({ "data-testid": "version-row", "aria-selected": one.version === looked.value?.version })} cells=${(one) => html`<td class="k">${one.version}</td><td>${`${one.at_utc}`.slice(0, 10)} ${clock(one.at_utc)}</td><td>${one.author}</td><td>${one.reason ?? ""}</td><td class="num">${one.rows}<span class="phone"> rows</span></td><td>${one.sha256 === sha256 ? html`<span class="m">in force</span>` : html`<button class="btn sm soft" onClick=${() => { looked.value = one; }}>Differences<span class="vh"> of version ${one.version}</span></button>`}</td>`} />
      ${all.length >= limit.value && limit.value < MOST_LISTED && html`<p class="pad"><button class="btn sm soft" onClick=${() => { limit.value = Math.min(MOST_LISTED, 10 * limit.value); }}>Older ones</button></p>`}`}<//><//>
    ${looked.value && html`<${Version} key=${`${looked.value.version} ${sha256}`} id=${id} version=${looked.value} onBring=${(text, number) => { looked.value = null; onBring(text, number); }} />`}`;
}

export function Schedule({ id }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}/observatory/schedule`);
  const entry = states?.get(`${id}/observatory/schedule/state`);
  const plan = useForecast(id);
  const summary = net.value.get(id);
  const site = siteOf(summary);
  /** The editor while somebody edits, or null; it is asked for when it is needed. */
  const Editor = useSignal(null);
  const draft = useMemo(() => draftOf(id), [id]);
  const problem = useSignal(null);
  const limit = useSignal(LISTED);
  const versions = useGet(entry && `${base(id)}/revisions?limit=${limit.value}`, 60);
  // The number in the list is the one that everybody is told; the node's own begins anew with each start.
  const version = Array.isArray(versions.data) ? versions.data.find((one) => one.sha256 === entry?.body.sha256)?.version : null;
  const report = useReport(id, tonight(summary));
  const close = () => { Editor.value = null; };
  const edit = async (first = async () => {}) => {
    problem.value = null;
    try {
      await first();
      Editor.value = (await import("../editor.js")).Editor;
    } catch (error) {
      problem.value = error;
    }
  };
  const running = (Array.isArray(entry?.body.rows) ? entry.body.rows : []).filter((row) => row?.status === "running").map((row) => row.start_utc).join(" ");
  // Drawn for its own changes, not with each second.
  const editor = useMemo(() => Editor.value && html`<${Editor.value} id=${id} draft=${draft} version=${version} sha256=${entry?.body.sha256} running=${running} site=${site} close=${close} />`, [Editor.value, draft, version, entry?.body.sha256, running, site?.lat, site?.lon]);
  if (!entry) return html`<p class="m">No schedule received yet.</p>`;
  const { rows, file, refused } = entry.body;
  const { worth, until } = stateOf(states, `${id}/observatory/schedule/state`);
  const bring = (text, number) => edit(async () => {
    await draft.begin();
    draft.bring(text, number);
    scrollTo(0, 0);
  });
  return html`${problem.value && html`<div class="note p2" role="alert"><span class="grow">${problem.value.message}</span></div>`}
    ${editor ? html`<div class="row wrap"><span class="grow m">Nothing of the draft is in force until it is activated.</span><button class="btn soft" onClick=${close}>Close the draft</button></div>${editor}`
    : html`<${Card} name="The night" end=${html`<${OldNight} report=${report} plan=${plan} /><${Keys} />`} cls="tl"><${Night} rows=${rows} plan=${plan.data?.rows} report=${report.data} site=${site} now=${skyNow()} /><//>
    ${refused && html`<div class="note p2"><span class="grow"><b>The file's newest text was not taken.</b> ${refused}</span></div>`}
    <${Card} name="Rows of tonight" flush end=${html`${worth !== "fresh" && html`<span class="ink-stale" data-testid="was">as of ${hourMinute(until)}; not known since</span>`}<span class="mono">${file}</span>${version == null ? "" : `, version ${version}`} <button class="btn sm soft" onClick=${() => edit()}>Edit a draft</button>`}><${Rows} id=${id} sha256=${entry.body.sha256} rows=${rows} plan=${plan.data} /><//>`}
    <${Versions} id=${id} sha256=${entry.body.sha256} list=${versions} limit=${limit} onBring=${bring} />`;
}
