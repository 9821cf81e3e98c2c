// Weather and safety: every parameter with its limits in view, every reason with the time it can clear, on one cursor.
import { html } from "../lib.js";
import { Chart, pointsOf } from "../chart.js";
import { devicesOf, known, stateOf } from "../devices.js";
import { clock, duration, number } from "../format.js";
import { SPANS, hoursBack, spanWords, useHistory } from "../history.js";
import { Input, PARAMETERS, inputValue, limitsOf } from "../inputs.js";
import { Age, Bullet, Card, Empty, Guard, Loaded, Segment, Table, Time, Was, Words, realTime, standing } from "../parts.js";
import { bySite } from "../shell.js";
import { ageOf, net, quality, skyAgeOf, skyNow, tick, useTopic } from "../store.js";
import { Webcams } from "../webcams.js";

/** What has these units is shown from nothing on. */
const MEASURED_FROM_ZERO = ["m/s", "%", "mm/h"];

/** Intervals in which the verdict was not safe, as pairs of times; the last one ends when it was last heard of. */
function unsafeTimes({ body, worth, until }, t0, t1) {
  const out = (body?.intervals ?? []).map((interval) => [interval, Date.parse(interval.from_utc), interval.until_utc ? Date.parse(interval.until_utc) : worth === "fresh" ? t1 : until]).filter(([interval]) => interval.verdict !== "safe").map(([, from, to]) => [Math.max(from, t0), to]);
  return out.filter(([from, to]) => to > from);
}

function Reasons({ summary, entry, state }) {
  const now = standing(summary);
  const since = entry ? skyAgeOf(entry) : 0;
  const reasons = entry?.body.reasons ?? [];
  const sky = skyNow();
  const fresh = state.worth === "fresh";
  return html`<${Card} name="Safety" testid="reasons" end=${entry && (fresh ? html`since <${Time} utc=${entry.body.since_utc} />` : html`<${Was} state=${state} word=${entry.body.verdict} />`)}><div class="row"><${Words} now=${now} lg /></div>
    ${!entry ? html`<p class="m">No verdict received yet.</p>` : reasons.length ? html`<${Table} label="Reasons" columns=${[{ key: "i", name: "Reason" }, { key: "w", name: "Why" }, { key: "c", name: "Can clear", num: true }]} rows=${reasons} keyOf=${(reason) => reason.input}
      cells=${(reason) => { const left = reason.clears_in_s == null || !fresh ? null : Math.max(0, reason.clears_in_s - since); return html`<td class="k"><${Input} input=${reason.input} /></td><td>${reason.why}</td><td class="num">${left === null ? "not known" : html`<b>${clock(sky + left * 1000)}</b>, in ${duration(left)}`}</td>`; }} />` : html`<p class="m">${fresh ? "Every input of the verdict is good." : "Every input of the verdict was good then."}</p>`}
    ${(entry?.body.advisories ?? []).map((advice) => html`<p class="note p3" key=${advice.input}><b><${Input} input=${advice.input} /></b> ${advice.why}</p>`)}<//>`;
}

function Station({ id, device, inputs, safety }) {
  const [hours, choose] = hoursBack(SPANS, 6);
  const measured = PARAMETERS.filter(([, name]) => known(device.fields[name]));
  const owner = `${device.site}/${device.telescope}`;
  // All of it stays below 300 kB.
  const points = Math.min(400, Math.floor(2200 / Math.max(1, measured.length)));
  const past = useHistory(owner, measured.map(([property]) => `${device.kind}/${device.name}/${property}`), hours, points);
  const series = (property) => past.series(`${device.kind}/${device.name}/${property}`);
  return html`<${Card} name=${`${device.name}, now`} flush end=${html`<${Age} s=${device.age} worth=${device.worth} after=" ago" />`} testid="station"><${Table} label="Weather now" columns=${[{ key: "p", name: "Parameter" }, { key: "v", name: "Value", num: true }, { key: "s", name: "On its scale" }, { key: "l", name: "Limit", num: true }, { key: "r", name: `Least and most, ${spanWords(hours)}`, num: true, cls: "hidep" }]} rows=${measured} keyOf=${([property]) => property}
      cells=${([property, name, label, unit, scale, digits]) => {
        const value = device.worth === "lost" ? null : device.fields[name];
        const [limit] = limitsOf(inputs, device.name, property);
        const points = series(property)?.points ?? [];
        const least = Math.min(...points.map((point) => point.min ?? point.mean));
        const most = Math.max(...points.map((point) => point.max ?? point.mean));
        const over = limit && value !== null && (limit.side === "below" ? value < limit.v : value > limit.v);
        return html`<td class="k">${label}</td><td class="num"><b class=${over ? "ink-p2" : null} data-value=${value}>${value === null ? "—" : number(value, digits)}</b> ${unit}</td><td><${Bullet} value=${value} from=${scale[0]} to=${scale[1]} limit=${limit?.v} below=${limit?.side === "below"} over=${over} range=${points.length ? [least, most] : null} /></td>
          <td class="num">${limit ? `${limit.side === "below" ? "≥" : "≤"} ${number(limit.v, digits)}` : "—"}</td><td class="num hidep">${points.length ? `${number(least, digits)} … ${number(most, digits)}` : "—"}</td>`;
      }} /><//>
    <${Card} name="The past" end=${html`<${Segment} label="How far back" options=${SPANS} value=${hours} onChange=${choose} />`}><${Loaded} of=${past} what="The past">${() => {
      const panels = measured.filter(([property]) => series(property)?.points.length).map(([property, , label, unit, , digits]) => ({ name: label, unit, digits, height: 110, zero: MEASURED_FROM_ZERO.includes(unit), limits: limitsOf(inputs, device.name, property),
        series: [{ name: "", head: `${label} mean`, points: pointsOf(series(property)), colour: "--s4" }, { name: "most", points: pointsOf(series(property), "max"), colour: "--s1", width: 0.7, quiet: true }, { name: "least", points: pointsOf(series(property), "min"), colour: "--s1", width: 0.7, quiet: true }] }));
      if (!panels.length) return html`<${Empty} icon="cloud" title="The archive has no weather of this time yet" />`;
      return html`<p class="tagline">Line: mean. Thin lines: least and most of each piece, so that a gust of seconds is seen over three days. Hatched: beyond a limit. Bar at the foot: not safe.</p>
        <${Chart} t0=${past.t0} t1=${past.t1} now=${past.t1} unsafe=${unsafeTimes(safety, past.t0, past.t1)} panels=${panels} />`;
    }}<//><//>`;
}

/** The weather as one telescope judges it. */
export function Weather({ id, summary }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}`);
  const entry = states?.get(`${id}/observatory/safety/state`);
  const state = stateOf(states, `${id}/observatory/safety/state`);
  const inputs = entry?.body.inputs ?? [];
  const stations = devicesOf(states).filter((device) => device.kind === "observingconditions");
  return html`${!summary.shared && html`<div class="grid g-side"><${Reasons} summary=${summary} entry=${entry} state=${state} /><${Card} name="Inputs" flush><${Table} label="Inputs of the verdict" columns=${[{ key: "i", name: "Input" }, { key: "v", name: "Value" }, { key: "a", name: `Age${realTime()}`, num: true }]} rows=${inputs} keyOf=${(input) => input.input}
      cells=${(input) => html`<td class="k">${input.good ? "" : "▼ "}<${Input} input=${input.input} /></td><td>${inputValue(input)}</td><td class="num"><${Age} s=${input.age_s == null ? null : input.age_s + ageOf(entry)} worth=${quality(ageOf(entry), entry.period_s)} never="never" /></td>`} /><//></div>`}
    <${Guard} name="Webcams"><${Webcams} of=${[{ site: summary.site_id, telescope: summary.shared ? null : summary.telescope_id }]} /><//>
    ${stations.length ? stations.map((device) => html`<${Station} key=${device.key} id=${id} device=${device} inputs=${inputs} safety=${state} />`) : html`<${Empty} icon="cloud" title="No weather station">None of this telescope or its site is on the bus.<//>`}`;
}

/** The weather of every site. */
export function AllWeather() {
  tick.value; // eslint-disable-line no-unused-expressions
  return html`<div class="page-h"><h1 tabindex="-1">Weather</h1></div>${[...bySite([...net.value.values()])].map(([site, telescopes]) => html`<section key=${site} class="stack" aria-label=${site}><h2>${site}</h2><div class="grid g3">${telescopes.map((summary) => {
    const now = standing(summary);
    return html`<section class="card" key=${summary.id}><header><h2><a href=${`/t/${summary.id}/weather`}>${summary.telescope_id}</a></h2></header><${Words} now=${now} />${(now.fresh ? summary.safety?.reasons ?? [] : []).map((reason) => html`<p key=${reason.input}><b><${Input} input=${reason.input} /></b> ${reason.why}</p>`)}
      ${summary.safety?.time_to_safe_s != null && now.safety === "unsafe" && html`<p class="m">Safe at the earliest in ${duration(summary.safety.time_to_safe_s)}.</p>`}<p><a class="btn sm soft" href=${`/t/${summary.id}/weather`}>Limits and history</a></p></section>`;
  })}</div><${Guard} name="Webcams"><${Webcams} of=${[{ site }]} /><//></section>`)}`;
}
