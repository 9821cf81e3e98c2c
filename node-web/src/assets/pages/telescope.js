// One telescope now: what it does, why, until when, what it waits for; its night, its image, its devices.
import { html, signal, useEffect, useMemo } from "../lib.js";
import { Chart, broken } from "../chart.js";
import { devicesOf, exposure, stateOf, useMissing } from "../devices.js";
import { clock, duration, hourMinute, number, plain } from "../format.js";
import { arrived, Picture } from "../image.js";
import { Keys, Night, OldNight } from "../night.js";
import { useGet, useReport, useShared } from "../api.js";
import { siteOf, tonight } from "../site.js";
import { useForecast } from "../forecast.js";
import { Age, Card, Empty, Expected, Guard, Missing, Old, Priority, Stat, Table, Time, Was, fate, isCalm, priorityNumber, realTime, standing } from "../parts.js";
import { ageOf, moment, quality, skyAgeOf, skyNow, tick, useTopic } from "../store.js";
import { useCorrections } from "../corrections.js";
import { activity } from "../activity.js";
import { Input, inputValue, inputWords } from "../inputs.js";

const body = (states, key) => states?.get(key)?.body;

/** Rows of tonight's schedule: the one that runs, and the next. */
function rowsOf(states, id) {
  const rows = body(states, `${id}/observatory/schedule/state`)?.rows ?? [];
  return { rows, running: rows.filter((row) => row.status === "running"), next: rows.find((row) => row.status === "pending") };
}

/** What keeps it closed, or would: `{ what, why, at }` each, with the sky time (ms) at which it can clear at the earliest, or in words until when it holds. */
function holds(summary, states, id, sky) {
  const safety = states?.get(`${id}/observatory/safety/state`);
  const since = safety ? skyAgeOf(safety) : 0;
  const orders = body(states, `${id}/observatory/operator-orders/state`) ?? {};
  const lease = body(states, `${id}/observatory/lease/state`);
  const out = (safety?.body.reasons ?? summary.safety?.reasons ?? []).map((reason) => ({ what: inputWords(reason.input), input: reason.input, why: reason.why, at: reason.clears_in_s == null ? null : sky + Math.max(0, reason.clears_in_s - since) * 1000 }));
  if (orders.stay_closed) out.push({ what: "an order", why: `${orders.stay_closed.from} closed it at ${clock(orders.stay_closed.at_utc)}${orders.stay_closed.reason ? `: ${orders.stay_closed.reason}` : ""}`, until: "somebody orders open-again" });
  if (orders.control) out.push({ what: "control", why: `${orders.control.from} took it from the schedule at ${clock(orders.control.at_utc)}${orders.control.reason ? `: ${orders.control.reason}` : ""}`, until: "somebody orders start" });
  if (summary.mode === "manual") out.push({ what: "robotic mode", why: "it is switched off", until: "somebody orders start" });
  if (lease && !lease.holder) out.push({ what: "command", why: "nobody commands it", until: "an observatory node takes command" });
  for (const [key, entry] of states ?? []) if (key.endsWith("/guard") && entry.body?.hold) out.push({ what: key.split("/")[4], why: "its device node closed it by itself, and opens for nobody", until: "the node in command goes on" });
  const { rows, next } = rowsOf(states, id);
  const isDue = rows.some((row) => ["running", "interrupted", "pending"].includes(row.status) && Date.parse(row.start_utc) <= sky && Date.parse(row.end_utc) > sky);
  if (rows.length && !isDue) out.push(next ? { what: "the schedule", why: `no row is due before ${[next.action, next.object].filter(Boolean).join(" ")}`, at: Date.parse(next.start_utc) } : { what: "the schedule", why: "no row is left", until: "another schedule is put in force" });
  return out;
}

/** Each reason with the time at which it can clear, the last one first: that is the one that it waits for. */
function Holds({ list, sky, open }) {
  const sorted = [...list].sort((a, b) => (b.at ?? Infinity) - (a.at ?? Infinity));
  return html`<div data-testid="reasons"><div class="tagline">${open ? "Ought to be closed because of" : "Keeps it closed"}</div><ul class="holds">${sorted.map((one) => html`<li key=${one.input ?? one.what}><b title=${one.input ?? null}>${one.what}</b><span>${one.why}</span><span class="m end">${one.at ? html`can clear <b>${clock(one.at)}</b>, <span class="nw">in ${duration((one.at - sky) / 1000)}</span>` : one.until ? `until ${one.until}` : "when it can clear is not known"}</span></li>`)}</ul></div>`;
}

/** One alert: what to do while it stands, and what became of it once nobody is called for it. */
function AlertNote({ id, alert }) {
  const calm = isCalm(alert);
  return html`<div class=${`note ${calm ? "" : `p${Math.min(3, priorityNumber(alert.priority))}`}`} data-testid="alert" data-alert=${alert.id}><${Priority} word=${alert.priority} off=${calm} /><div class="grow">
    ${calm ? html`<span class="m">${alert.cause} ${fate(alert)}.</span>` : html`<b>${alert.cause}</b> ${alert.consequence} <em>${alert.action}</em><span class="m"> since ${clock(alert.raised_utc)}</span>`}<${Late} part="cameback" alert=${alert} id=${id} /></div></div>`;
}

function Doing({ id, summary, states }) {
  const now = standing(summary);
  const [what, sub] = activity(summary, now);
  const missing = useMissing(summary, now, states);
  const { rows, running, next } = rowsOf(states, id);
  const row = running[0];
  const camera = summary.activity?.[0]?.camera;
  const light = now.fresh && camera ? exposure(states, id, camera) : null;
  const sky = skyNow() ?? 0;
  const list = now.fresh && (now.posture !== "open" || now.safety !== "safe") ? holds(summary, states, id, sky) : [];
  const times = list.map((one) => one.at ?? null);
  const earliest = times.length && !times.includes(null) ? Math.max(...times) : null;
  const why = !now.fresh ? "Not known while the observatory node is silent." : row ? `Row ${row.row + 1} of ${rows.length}${row.detail ? `: ${row.detail}` : ""}.` : list.length ? `${list.length > 1 ? `${list.length} reasons keep it closed; they are` : "One reason keeps it closed; it is"} below.` : summary.mode === "robotic" ? "No row may run now." : `It is ${summary.mode}.`;
  const until = !now.fresh ? "Not known." : row ? html`<b>${hourMinute(row.end_utc)} UTC</b>, in ${duration((Date.parse(row.end_utc) - (skyNow() ?? Date.parse(row.end_utc))) / 1000)}${row.frames_wanted ? `, ${Math.max(0, row.frames_wanted - row.frames)} frames more` : ""}.` : earliest ? html`<b>${clock(earliest)} UTC</b> at the earliest, in ${duration((earliest - sky) / 1000)}.` : list.length ? "Not known: see below." : "—";
  const after = rows.find((one) => one.status === "interrupted" && Date.parse(one.end_utc) > sky) ?? next;
  const then = after ? ` Then ${[after.action, after.object].filter(Boolean).join(" ")}${after.status === "interrupted" ? " goes on" : ` at ${hourMinute(after.start_utc)}`}.` : "";
  const waits = !now.fresh ? "Not known." : list.length ? `${list.map((one) => one.what).join(", ").replace(/^./, (first) => first.toUpperCase())}.${then}` : row ? `Nothing.${next ? ` Next: ${[next.action, next.object].filter(Boolean).join(" ")} at ${hourMinute(next.start_utc)}.` : ""}` : next ? `${next.action} at ${hourMinute(next.start_utc)}.` : "Nothing.";
  return html`<section class="card stack" aria-label="Now" data-testid="now"><div class="row start wrap"><div class="grow"><div class="tagline">Does</div><div class="row base wrap"><span class="big">${what}</span><span class="m">${sub}</span><${Missing} of=${missing} />${now.fresh && html`<${Expected} by=${summary.activity?.[0]?.expected_by_utc} />`}</div></div>
      ${light && html`<div class="light"><div class="row between"><span class="m">this frame</span><span><b>${number(light.passed, 0)}</b> <span class="m">of ${plain(light.total)} s</span></span></div><div class="bar lg lit"><i style=${{ width: `${(light.part * 100).toFixed(1)}%` }}></i></div></div>`}</div>
    <div class="grid g3"><div><div class="tagline">Why</div><div>${why}</div></div><div><div class="tagline">Until</div><div>${until}</div></div><div><div class="tagline">Waits for</div><div>${waits}</div></div></div>
    ${list.length > 0 && html`<${Holds} list=${list} sky=${sky} open=${now.posture !== "closed"} />`}
    ${(summary.alerts ?? []).map((alert) => html`<${AlertNote} key=${alert.id} id=${id} alert=${alert} />`)}
    ${(summary.unreadable ?? []).map((odd) => html`<div key=${odd.key} class="note p2" data-unreadable=${odd.key}><div class="grow"><b>${odd.key} cannot be read.</b> ${odd.why}</div></div>`)}</section>`;
}

/** The verdict with every input; what keeps it closed stands in the first card. */
function Verdict({ id, summary, states }) {
  const entry = states?.get(`${id}/observatory/safety/state`);
  if (!entry) return html`<${Card} name="Safety"><p class="m">No verdict received yet.</p><//>`;
  const [since, skySince] = [ageOf(entry), skyAgeOf(entry)];
  const state = stateOf(states, `${id}/observatory/safety/state`);
  const fresh = state.worth === "fresh";
  const { suspended = [], advisories = [], inputs = [], since_utc: at } = entry.body;
  return html`<${Card} name="Safety" flush testid="safety" end=${fresh ? html`${entry.body.verdict} since <${Time} utc=${at} />` : html`<${Was} state=${state} word=${entry.body.verdict} />`}>
    ${[[fresh ? "No exposures of the sky" : "No exposures of the sky, then", suspended], [fresh ? "Near a limit" : "Near a limit, then", advisories]].map(([lead, list]) => list.length > 0 && html`<ul class="reasons" key=${lead}><li class="tagline">${lead}</li>${list.map((reason) =>
      html`<li key=${reason.input}><b><${Input} input=${reason.input} /></b> ${reason.why} ${fresh && reason.clears_in_s != null && html`<span class="m nw">can clear in ${duration(Math.max(0, reason.clears_in_s - skySince))}</span>`}</li>`)}</ul>`)}
    <${Table} label="Inputs of the verdict" columns=${[{ key: "i", name: "Input" }, { key: "v", name: "Value" }, { key: "a", name: `Age${realTime()}`, num: true }]} rows=${inputs} keyOf=${(input) => input.input}
      cells=${(input) => html`<td class="k"><${Input} input=${input.input} /></td><td>${inputValue(input)}${input.good ? "" : html` <b class="ink-p3">▼ ${fresh ? "" : "was "}unsafe</b>`}</td><td class="num"><${Age} s=${input.age_s == null ? null : input.age_s + since} worth=${quality(since, entry.period_s)} never="never" /></td>`} /><//>`;
}

function Image({ summary, states, id }) {
  const shown = arrived(summary);
  const newest = body(states, `${id}/observatory/frame/facts`);
  // The picture of a frame may come after the facts of the next one; then the archive knows those of this one.
  const isNewest = newest?.frame === shown?.frame;
  const asked = useGet(shown && !isNewest && !(newest?.started_utc < shown.started_utc) ? `/api/v1/telescopes/${id}/frames/${encodeURIComponent(shown.frame)}` : null, 10);
  if (!shown) return html`<${Card} name="Last image"><${Empty} icon="image" title="No frame yet" /><//>`;
  const mine = (isNewest ? newest : asked.data?.facts) ?? {};
  const fwhm = mine.fwhm_px == null ? [null] : mine.scale_arcsec_px == null ? [number(mine.fwhm_px), "px"] : [number(mine.fwhm_px * mine.scale_arcsec_px, 2), "″"];
  const age = (skyNow() - Date.parse(shown.started_utc)) / 1000 - shown.exposure_s;
  return html`<${Card} name="Last image" end=${html`${!isNewest && html`<${Old} of=${asked} /> `}<span class="age" data-testid="image-age">${clock(shown.started_utc)}, ${duration(age)} ago</span>`}>
    <a href=${`/t/${id}/frames/${encodeURIComponent(shown.frame)}`} class="img" aria-label="Open the last frame"><${Picture} image=${shown} /></a>
    <p class="tagline">${[shown.object ?? shown.image_type, shown.filter ?? "no filter", `${plain(shown.exposure_s)} s`, shown.camera].join(" · ")}</p>
    <div class="stats four"><${Stat} name="FWHM" value=${fwhm[0]} unit=${fwhm[1]} /><${Stat} name="Stars" value=${mine.stars} /><${Stat} name="Sky" value=${mine.sky_adu != null ? number(mine.sky_adu, 0) : null} unit=${mine.sky_adu != null && "ADU"} /><${Stat} name="Trailed" value=${mine.trailed == null ? null : mine.trailed ? "yes" : "no"} level=${mine.trailed ? "p3" : null} /></div>
    ${(mine.reason || shown.problem) && html`<p class="m">${mine.reason ?? shown.problem}</p>`}<//>`;
}

/** `observatory/alpha/main` in words. */
const nodeWords = (name) => { const [role, telescope, id] = String(name).split("/"); return `the ${role} node of ${telescope}${id === "main" ? "" : `, ${id}`}`; };

function Command({ id, states }) {
  const lease = states?.get(`${id}/observatory/lease/state`);
  const guards = [...(states ?? [])].filter(([key]) => key.endsWith("/guard"));
  const isFresh = (entry) => quality(ageOf(entry), entry.period_s) === "fresh";
  const age = (entry) => html`<${Age} s=${ageOf(entry)} worth=${quality(ageOf(entry), entry.period_s)} after=" ago" />`;
  return html`<${Card} name="Who is in command" testid="command">
    ${lease ? html`<p>${lease.body.holder ? html`In command ${isFresh(lease) ? "is" : "was"} <b title=${`${lease.body.holder}, token ${lease.body.token}, granted by ${lease.body.arbiter}`}>${nodeWords(lease.body.holder)}</b>` : `No node ${isFresh(lease) ? "is" : "was"} in command`} · ${age(lease)}</p>` : html`<p class="m">It is not known yet which node is in command.</p>`}
    ${guards.map(([key, entry]) => html`<p key=${key}><b>${key.split("/")[4]}</b>${isFresh(entry) ? "" : ", when it was last heard of:"} ${entry.body.may_be_open ? "may be open" : "must be closed"}${entry.body.action === "closing" ? ", closing" : ""}${entry.body.verified_closed ? ", verified closed" : ""}${entry.body.hold ? ", closed by itself until the node in command goes on" : ""}. <span class="m">${isFresh(entry) && (entry.body.permits ?? []).map((permit) => (permit.safe ? `${permit.telescope} says that it is safe; unless it says so again, this ends in ${number(Math.max(0, permit.left_s - ageOf(entry)), 0)} s${realTime()}. ` : `${permit.telescope} says that it is not safe. `))}${entry.body.permits?.length || !isFresh(entry) ? "" : "No telescope says that it is safe. "}</span> · ${age(entry)}</p>`)}<//>`;
}

/** How it guides: error of the last hour, both axes. */
function GuidingCard({ id, summary, states }) {
  const { body: guiding, worth } = stateOf(states, `${id}/observatory/guiding/state`);
  const past = useCorrections(id, 1);
  const axis = (name) => past.corrections.map((one) => [Date.parse(one.mid_utc), one[name]?.error_px ?? null]);
  const rms = summary.figures?.guide_rms_arcsec;
  const shown = worth !== "fresh" ? null : rms != null ? [number(rms, 2), "″"] : Number.isFinite(guiding.rms_px) && guiding.active ? [number(guiding.rms_px, 2), " px"] : null;
  return html`<${Card} label="Guiding" testid="guiding-card"><header><h2><a href=${`/t/${id}/guiding`}>Guiding</a></h2><span class="end"><${Old} of=${past} />${shown ? html`<span>RMS <b>${shown[0]}</b>${shown[1]}</span>` : worth === "fresh" ? "not guiding" : "not known"}</span></header>
    ${past.corrections.length ? html`<${Chart} plain label="Error of guiding, east and north, in the last hour" t0=${past.t0} t1=${past.t1} now=${past.t1} panels=${[{ name: "", unit: "px", digits: 2, height: 84, limits: [], series: [{ name: "east", points: axis("east"), colour: "--s1", kind: "dots", size: 4 }, { name: "north", points: axis("north"), colour: "--s2", kind: "dots", size: 4 }] }]} />` : html`<p class="m">${worth === "fresh" && guiding.detail ? plain(guiding.detail) : past.error?.message ?? (past.data === null ? "Reading the corrections …" : "No frame was guided on in the last hour.")}</p>`}<//>`;
}

/** How sharp it is: FWHM of the newest frames. */
function FocusCard({ id, summary, states }) {
  const { body: focus, worth } = stateOf(states, `${id}/observatory/focus/state`);
  const found = useGet(`/api/v1/telescopes/${id}/frames?image_type=light&limit=150`, 60);
  // It ends now, in steps of a minute.
  const t1 = useMemo(() => skyNow(), [found.at, Math.floor((moment.value ?? 0) / 60e3)]);
  const t0 = t1 - 3 * 3600e3;
  const points = (found.data?.rows ?? []).map((row) => row.found_frame).filter((frame) => frame?.fwhm_arcsec != null && Date.parse(frame.at_utc) > t0).map((frame) => [Date.parse(frame.at_utc), frame.fwhm_arcsec]);
  const now = summary.figures?.fwhm_arcsec;
  return html`<${Card} label="Focus" testid="focus-card"><header><h2><a href=${`/t/${id}/focus`}>Focus</a></h2><span class="end"><${Old} of=${found} /><span>FWHM <b>${now != null && standing(summary).fresh ? number(now, 2) : "—"}</b>″</span></span></header>
    ${points.length ? html`<${Chart} plain label="FWHM of the frames of the last three hours" t0=${t0} t1=${t1} now=${t1} panels=${[{ name: "", unit: "″", digits: 2, height: 70, zero: true, series: [{ name: "", points: broken(points), colour: "--s4", kind: "dots", size: 4 }] }]} />` : html`<p class="m">${worth === "fresh" && focus.detail ? plain(focus.detail) : found.error?.message ?? (found.data === null ? "Reading the frames …" : "No frame of the last three hours is measured.")}</p>`}<//>`;
}

function FramesCard({ id, summary, states }) {
  const report = useReport(id, tonight(summary));
  // What is announced after the report was made counts, too; before the first report, what the node has announced since its start.
  const base = useMemo(() => summary.frames, [report.data]);
  const taken = report.data?.disk ? report.data.disk.frames + Math.max(0, summary.frames - base) : summary.frames;
  const spooled = devicesOf(states).filter((device) => device.kind === "camera").reduce((sum, device) => sum + (Number(device.fields.spooled) || 0), 0);
  return html`<${Card} label="Frames" testid="frames-card"><header><h2><a href=${`/t/${id}/frames`}>Frames</a></h2><span class="end"><${Old} of=${report} />night so far</span></header><div class="stats three"><${Stat} name="Taken" value=${taken} worth=${standing(summary).fresh ? "fresh" : "stale"} /><${Stat} name="Refused" value=${report.data ? report.data.refused_frames?.length ?? 0 : null} /><${Stat} name="Not yet archived" value=${spooled} /></div><//>`;
}

/** The target of the row that runs: its place by its newest frame, else by where the mount points. */
function targetOf(states, id) {
  const row = rowsOf(states, id).running.find((one) => one.object);
  if (!row) return null;
  const frame = [...states].find(([key, { body: one }]) => key.startsWith(`${id}/device/camera/`) && key.endsWith("/frame") && one?.purpose?.object === row.object)?.[1].body.purpose;
  const mount = devicesOf(states).find((device) => device.kind === "telescope" && device.worth === "fresh" && device.fields.tracking === true)?.fields;
  const place = [frame, mount].find((one) => Number.isFinite(one?.ra_deg) && Number.isFinite(one?.dec_deg));
  return place ? { name: String(row.object), row: row.row, ra: place.ra_deg, dec: place.dec_deg, from: Date.parse(row.start_utc), to: Date.parse(row.end_utc) } : null;
}

/** Past, now and forecast on one axis. */
function NightCard({ id, summary, states, site }) {
  const schedule = body(states, `${id}/observatory/schedule/state`);
  const report = useReport(id, tonight(summary));
  const plan = useForecast(id);
  const safety = stateOf(states, `${id}/observatory/safety/state`);
  if (!skyNow()) return null;
  return html`<${Card} name="The night" cls="tl" testid="night" end=${html`<${OldNight} report=${report} plan=${plan} /><${Keys} />`}><${Night} rows=${schedule?.rows} plan=${plan.data?.rows} target=${targetOf(states, id)} report=${report.data} verdicts=${safety.body?.intervals} until=${safety.until} site=${site} now=${skyNow()} /><//>`;
}

function Sky({ id, states, site }) {
  const above = useShared(site ? `/api/v1/telescopes/${id}/sky` : null, 3600);
  const devices = devicesOf(states);
  const mount = devices.find((device) => device.kind === "telescope");
  const dome = devices.find((device) => device.kind === "dome");
  return html`<${Card} name="Sky" end="north up, east left" testid="sky">${site && skyNow() ? html`<${Late} part="sky" horizon=${above.data?.horizon} mount=${mount?.worth === "fresh" ? mount.fields : null} dome=${dome?.worth === "fresh" ? dome.fields : null} site=${site} now=${skyNow()} />` : html`<p class="m">Where the telescope stands is not known yet.</p>`}<//>`;
}

/** Parts that come after the page: it is there before they are. */
const LATE = { webcams: async () => (await import("../webcams.js")).Webcams, sky: async () => (await import("../sky.js")).SkyMap, devices: async () => (await import("../devicelist.js")).Devices, cameback: async () => (await import("../cameback.js")).CameBack };
/** @type {any} Those that have come. */
const come = signal({});

function Late({ part, ...props }) {
  useEffect(() => {
    if (!come.peek()[part]) LATE[part]().catch(() => () => html`<p class="m">The server did not send this part; load the page again.</p>`).then((Part) => { come.value = { ...come.peek(), [part]: Part }; });
  }, []);
  const Part = come.value[part];
  return Part ? html`<${Part} ...${props} />` : null;
}

export function Telescope({ id, summary }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}`);
  const site = siteOf(summary);
  if (summary.shared) return html`<${Late} part="devices" id=${id} states=${states} />`;
  return html`<${Doing} id=${id} summary=${summary} states=${states} />
    <${NightCard} id=${id} summary=${summary} states=${states} site=${site} />
    <div class="grid g3"><${Image} id=${id} summary=${summary} states=${states} /><${Sky} id=${id} states=${states} site=${site} /><div class="stack"><${GuidingCard} id=${id} summary=${summary} states=${states} /><${FocusCard} id=${id} summary=${summary} states=${states} /><${FramesCard} id=${id} summary=${summary} states=${states} /></div></div>
    <${Guard} name="Webcams"><${Late} part="webcams" of=${[{ site: summary.site_id, telescope: summary.telescope_id }]} /><//>
    <div class="grid g-side"><${Verdict} id=${id} summary=${summary} states=${states} /><${Command} id=${id} states=${states} /></div>
    <${Late} part="devices" id=${id} states=${states} />`;
}
