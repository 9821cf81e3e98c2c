// One telescope now: what it does, why, until when, what it waits for; its night, its image, its devices.
import { html } from "../lib.js";
import { devicesOf, exposure, stateWords, values } from "../devices.js";
import { clock, duration, hourMinute, number, plain } from "../format.js";
import { arrived, Picture } from "../image.js";
import { Night } from "../night.js";
import { nightOf } from "./frames.js";
import { useGet } from "../api.js";
import { SkyMap } from "../sky.js";
import { useSite } from "../site.js";
import { useForecast } from "./schedule.js";
import { Age, Card, Empty, Icon, Priority, Stat, Table, Time, standing } from "../parts.js";
import { ageOf, quality, skyNow, tick, useTopic } from "../store.js";
import { activity } from "./network.js";
import { inputValue } from "./weather.js";

const body = (states, key) => states?.get(key)?.body;

/** Rows of tonight's schedule: the one that runs, and the next. */
function rowsOf(states, id) {
  const rows = body(states, `${id}/observatory/schedule/state`)?.rows ?? [];
  return { rows, running: rows.filter((row) => row.status === "running"), next: rows.find((row) => row.status === "pending") };
}

function Doing({ id, summary, states }) {
  const now = standing(summary);
  const [what, sub] = activity(summary, now);
  const { rows, running, next } = rowsOf(states, id);
  const row = running[0];
  const camera = summary.activity?.[0]?.camera;
  const light = now.fresh && camera ? exposure(states, id, camera) : null;
  const reasons = now.fresh ? summary.safety?.reasons ?? [] : [];
  const why = !now.fresh ? "Not known while the observatory node is silent." : row ? `Row ${row.row + 1} of ${rows.length}${row.detail ? `: ${row.detail}` : ""}.` : reasons.length ? `${reasons.length} ${reasons.length > 1 ? "reasons keep" : "reason keeps"} it closed; they are below.` : summary.mode === "robotic" ? "No row may run now." : `It is ${summary.mode}.`;
  const until = row ? html`<b>${hourMinute(row.end_utc)} UTC</b>, in ${duration((Date.parse(row.end_utc) - (skyNow() ?? Date.parse(row.end_utc))) / 1000)}${row.frames_wanted ? `, ${Math.max(0, row.frames_wanted - row.frames)} frames more` : ""}.` : "—";
  const waits = reasons.length && summary.safety?.time_to_safe_s != null ? `A safe sky, ${clock((skyNow() ?? 0) + summary.safety.time_to_safe_s * 1000)} UTC at the earliest.` : row ? `Nothing.${next ? ` Next: ${[next.action, next.object].filter(Boolean).join(" ")} at ${hourMinute(next.start_utc)}.` : ""}` : next ? `${next.action} at ${hourMinute(next.start_utc)}.` : "Nothing.";
  return html`<section class="card stack" aria-label="Now" data-testid="now"><div class="row start wrap"><div class="grow"><div class="tagline">Does</div><div class="row base wrap"><span class="big">${what}</span><span class="m">${sub}</span></div></div>
      ${light && html`<div class="light"><div class="row between"><span class="m">this frame</span><span><b>${number(light.passed, 0)}</b> <span class="m">of ${plain(light.total)} s</span></span></div><div class="bar lg lit"><i style=${{ width: `${(light.part * 100).toFixed(1)}%` }}></i></div></div>`}</div>
    <div class="grid g3"><div><div class="tagline">Why</div><div>${why}</div></div><div><div class="tagline">Until</div><div>${until}</div></div><div><div class="tagline">Waits for</div><div>${waits}</div></div></div>
    ${(summary.alerts ?? []).map((alert) => html`<div key=${alert.id} class=${`note p${Math.min(3, ["critical", "high", "medium", "advisory"].indexOf(alert.priority) + 1)}`} data-testid="alert" data-alert=${alert.id}><${Priority} word=${alert.priority} /><div class="grow"><b>${alert.cause}</b> ${alert.consequence} <em>${alert.action}</em>
      <span class="m"> since ${clock(alert.raised_utc)}${alert.acknowledged_by ? `, acknowledged by ${alert.acknowledged_by}` : ""}</span></div></div>`)}
    ${(summary.unreadable ?? []).map((odd) => html`<div key=${odd.key} class="note p2" data-unreadable=${odd.key}><div class="grow"><b>${odd.key} cannot be read.</b> ${odd.why}</div></div>`)}</section>`;
}

/** Every reason why it is closed, with the time each can clear, and every input of the verdict. */
function Verdict({ id, summary, states }) {
  const entry = states?.get(`${id}/observatory/safety/state`);
  if (!entry) return html`<${Card} name="Safety"><p class="m">No verdict received yet.</p><//>`;
  const since = ageOf(entry);
  const { reasons = [], suspended = [], advisories = [], inputs = [], since_utc: at } = entry.body;
  return html`<${Card} name="Safety" flush testid="safety" end=${html`${entry.body.verdict} since <${Time} utc=${at} />`}>
    ${[["Keeps it closed", reasons], ["No exposures of the sky", suspended], ["Near a limit", advisories]].map(([lead, list]) => list.length > 0 && html`<ul class="reasons" key=${lead} data-testid="reasons"><li class="tagline">${lead}</li>${list.map((reason) =>
      html`<li key=${reason.input}><b>${reason.input}</b> ${reason.why} ${reason.clears_in_s != null && html`<span class="m nw">can clear in ${duration(Math.max(0, reason.clears_in_s - since))}</span>`}</li>`)}</ul>`)}
    <${Table} label="Inputs of the verdict" columns=${[{ key: "i", name: "Input" }, { key: "v", name: "Value" }, { key: "a", name: "Age", num: true }]} rows=${inputs} keyOf=${(input) => input.input}
      cells=${(input) => html`<td class="k">${input.input}</td><td>${inputValue(input)}${input.good ? "" : html` <b class="ink-p3">▼ unsafe</b>`}</td><td class="num"><${Age} s=${input.age_s == null ? null : input.age_s + since} worth=${quality(since, entry.period_s)} never="never" /></td>`} /><//>`;
}

function Image({ summary, states, id }) {
  const shown = arrived(summary);
  if (!shown) return html`<${Card} name="Last image"><${Empty} icon="image" title="No frame yet" /><//>`;
  const facts = body(states, `${id}/observatory/frame/facts`);
  const mine = facts?.frame === shown.frame ? facts : {};
  const age = ageOf(shown);
  return html`<${Card} name="Last image" end=${html`<span class="age">${clock(shown.started_utc)}, <${Age} s=${age} worth="fresh" /></span>`}>
    <a href=${`/t/${id}/frames/${encodeURIComponent(shown.frame)}`} class="img" aria-label="Open the last frame"><${Picture} image=${shown} /></a>
    <p class="tagline">${[shown.object ?? shown.image_type, shown.filter ?? "no filter", `${plain(shown.exposure_s)} s`, shown.camera].join(" · ")}</p>
    <div class="stats"><${Stat} name="FWHM" value=${mine.fwhm_px != null ? number(mine.fwhm_px) : null} unit="px" /><${Stat} name="Stars" value=${mine.stars} /><${Stat} name="Sky" value=${mine.sky_adu != null ? number(mine.sky_adu, 0) : null} unit="ADU" /><${Stat} name="Trailed" value=${mine.trailed == null ? null : mine.trailed ? "yes" : "no"} level=${mine.trailed ? "p3" : null} /></div>
    ${(mine.reason || shown.problem) && html`<p class="m">${mine.reason ?? shown.problem}</p>`}<//>`;
}

function Command({ id, states }) {
  const lease = states?.get(`${id}/observatory/lease/state`);
  const guards = [...(states ?? [])].filter(([key]) => key.endsWith("/guard"));
  return html`<${Card} name="Command and guard">
    ${lease ? html`<p>${lease.body.holder ? html`<b>${lease.body.holder}</b> commands, token ${lease.body.token}, granted by ${lease.body.arbiter}` : "Nobody commands"} · <${Age} s=${ageOf(lease)} worth=${quality(ageOf(lease), lease.period_s)} /></p>` : html`<p class="m">No lease received yet.</p>`}
    ${guards.map(([key, entry]) => html`<p key=${key}><b>${key.split("/")[4]}</b> ${entry.body.may_be_open ? "may be open" : "must be closed"}${entry.body.action === "closing" ? ", closing" : ""}${entry.body.verified_closed ? ", verified closed" : ""}${entry.body.hold ? ", on hold" : ""}
      ${(entry.body.permits ?? []).map((permit) => html`<span class="m" key=${permit.telescope}> · ${permit.telescope} ${permit.safe ? "safe" : "unsafe"}, permit ends in ${number(Math.max(0, permit.left_s - ageOf(entry)), 0)} s</span>`)}${entry.body.permits?.length ? "" : html`<span class="m"> · no permit</span>`} · <${Age} s=${ageOf(entry)} worth=${quality(ageOf(entry), entry.period_s)} /></p>`)}<//>`;
}

export function Devices({ id, states }) {
  const devices = devicesOf(states);
  const connected = devices.filter((device) => !device.lost).length;
  return html`<${Card} name="Devices" flush testid="devices" end=${`${connected} of ${devices.length} connected`}>
    ${devices.length ? html`<${Table} label="Devices" cls="cards" columns=${[{ key: "d", name: "Device" }, { key: "s", name: "State" }, { key: "v", name: "Values" }, { key: "a", name: "Age", num: true }, { key: "p", name: "Period", num: true, cls: "hidep" }]} rows=${devices} keyOf=${(device) => device.key}
      rowProps=${(device) => ({ "data-quality": device.worth, "data-testid": "device", "data-device": `${device.kind}/${device.name}`, "data-link": device.body.link?.is ?? "unknown" })}
      cells=${(device) => html`<td class="k"><a href=${`/t/${device.site}/${device.telescope}/devices/${device.kind}/${device.name}`}><${Icon} name=${device.icon} />${device.name} <span class="mm">${device.kind}${device.telescope === "shared" ? ", shared" : ""}</span></a></td><td>${device.lost ? html`<b class="ink-p2">no link</b>` : stateWords(device)}</td>
        <td class="full"><span class="row wrap">${values(device).map(([value, unit], i) => html`<span class="nw" key=${i}><b>${value}</b> ${unit}</span>`)}</span></td><td class="num"><${Age} s=${device.age} worth=${device.worth} /></td><td class="num hidep mm">${plain(device.entry.period_s)} s</td>`} />` : html`<p class="m">No device has published yet.</p>`}<//>`;
}

/** Past, now and forecast on one axis. */
function NightCard({ id, states, site }) {
  const schedule = body(states, `${id}/observatory/schedule/state`);
  const night = skyNow() && nightOf(skyNow());
  const report = useGet(night && `/api/v1/telescopes/${id}/nights/${night}/report`, 60);
  const plan = useForecast(id, schedule?.revision);
  if (!skyNow()) return null;
  return html`<${Card} name="The night" cls="tl" testid="night" end=${html`<span class="key">exposed</span><span class="key dash">forecast</span><span class="desk">hatched: closed for weather</span>`}><${Night} rows=${schedule?.rows} plan=${plan?.rows} done=${report.data?.timeline} site=${site} now=${skyNow()} /><//>`;
}

function Sky({ states, site }) {
  const devices = devicesOf(states);
  const mount = devices.find((device) => device.kind === "telescope");
  const dome = devices.find((device) => device.kind === "dome");
  return html`<${Card} name="Sky" end="north up, east left" testid="sky">${site && skyNow() ? html`<${SkyMap} mount=${mount?.worth === "fresh" ? mount.fields : null} dome=${dome?.worth === "fresh" ? dome.fields : null} site=${site} now=${skyNow()} />` : html`<p class="m">Where the telescope stands is not known yet.</p>`}<//>`;
}

export function Telescope({ id, summary }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}`);
  const site = useSite(id, states);
  if (summary.shared) return html`<${Devices} id=${id} states=${states} />`;
  return html`<${Doing} id=${id} summary=${summary} states=${states} />
    <${NightCard} id=${id} states=${states} site=${site} />
    <div class="grid g3"><${Image} id=${id} summary=${summary} states=${states} /><${Sky} states=${states} site=${site} /><div class="stack"><${Verdict} id=${id} summary=${summary} states=${states} /><${Command} id=${id} states=${states} /></div></div>
    <${Devices} id=${id} states=${states} />`;
}
