// Guiding: is it good, what was corrected, and why; error, pulse and stars on one cursor.
import { html } from "../lib.js";
import { Chart, broken } from "../chart.js";
import { useCorrections } from "../corrections.js";
import { clock, number } from "../format.js";
import { hoursBack } from "../history.js";
import { Age, Card, Empty, Loaded, Old, Segment, Stat, Table } from "../parts.js";
import { Plane } from "../plane.js";
import { go, route, withQuery } from "../route.js";
import { ageOf, quality, tick, useTopic } from "../store.js";

const HOURS = [[0.25, "15 min"], [2, "2 h"], [12, "12 h"]];
const words = (why) => String(why ?? "—").replaceAll("_", " ");
const sentence = (text) => (text ? `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}` : "");
/** What was too surprising to be believed is drawn, and counts in no figure. */
const isOut = (one, axis) => one[axis]?.why === "outlier";
const rms = (values) => { const known = values.filter(Number.isFinite); return known.length ? Math.sqrt(known.reduce((sum, v) => sum + v * v, 0) / known.length) : null; };

function Now({ entry }) {
  const age = ageOf(entry);
  const worth = quality(age, entry.period_s);
  const { body } = entry;
  const { last } = body;
  const px = (value, digits = 2) => (Number.isFinite(value) ? number(value, digits) : null);
  return html`<${Card} label="Guiding now" testid="guiding-now"><div class="row wrap gaps"><${Stat} lg name="RMS of this field" value=${px(body.rms_px)} unit="px" worth=${worth} /><${Stat} lg name="East, last" value=${px(last?.east?.error_px)} unit="px" worth=${worth} /><${Stat} lg name="North, last" value=${px(last?.north?.error_px)} unit="px" worth=${worth} />
      <${Stat} lg name="Frames, corrected" value=${body.frames} sub=${body.corrected != null ? `${body.corrected} corrected` : null} worth=${worth} /><${Stat} lg name="Stars" value=${last?.stars} worth=${worth} /><${Stat} lg name="Transparency" value=${px(last?.transparency)} worth=${worth} /></div>
    <p class="m">${worth !== "fresh" ? html`<b>Not known now.</b> ${body.active ? `It was guiding ${body.object ?? ""}.` : "It was not guiding."}` : body.active ? html`<b>Guiding ${body.object ?? ""}.</b>` : html`<b>Not guiding now.</b>${last?.mid_utc ? ` ${last.object ?? "The last field"} ended at ${clock(last.mid_utc)}.` : ""}`} ${sentence(body.detail)} · <${Age} s=${age} worth=${worth} after=" ago" /></p><//>`;
}

function Calibration({ body }) {
  const { calibration, last } = body;
  if (!calibration) return html`<${Card} name="Calibration"><p class="m">None yet: the first guided frames give one.</p><//>`;
  const other = last?.pier_side && calibration.pier_side && last.pier_side !== calibration.pier_side;
  const pair = (value) => (Array.isArray(value) ? value.map((v) => number(v, 2)).join(", ") : "—");
  return html`<${Card} name="Calibration in use" end=${other && html`<span class="ink-p3">▼ of the other pier side</span>`}><dl class="kv"><dt>Made</dt><dd>${clock(calibration.made_utc)}, by ${words(calibration.source)}</dd><dt>Pier side</dt><dd><b>${calibration.pier_side ?? "—"}</b>${last?.pier_side ? html`, mount is <b>${last.pier_side}</b>` : ""}</dd>
    <dt>East</dt><dd>${pair(calibration.east_px_per_s)} px/s</dd><dt>North</dt><dd>${pair(calibration.north_px_per_s)} px/s</dd></dl><//>`;
}

const columns = (unit) => [{ key: "t", name: "Frame" }, { key: "e", name: `East, ${unit}`, num: true }, { key: "ep", name: "Pulse, ms", num: true }, { key: "ew", name: "Why" }, { key: "n", name: `North, ${unit}`, num: true }, { key: "np", name: "Pulse, ms", num: true }, { key: "nw", name: "Why" }, { key: "s", name: "Stars", num: true, cls: "hidep" }];

export function Guiding({ id }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}/observatory/guiding`);
  const entry = states?.get(`${id}/observatory/guiding/state`);
  const [hours, choose] = hoursBack(HOURS, 2);
  const past = useCorrections(id, hours);
  const optics = useTopic(`tel/${id}/observatory/optics`)?.get(`${id}/observatory/optics/state`)?.body.optics ?? [];
  const newest = [...past.corrections].reverse().slice(0, 12);
  const camera = newest[0]?.camera ?? entry?.body.camera;
  const scale = optics.filter((one) => one.camera === camera && Number.isFinite(one.scale_arcsec_px)).sort((a, b) => (a.at_utc < b.at_utc ? 1 : -1))[0]?.scale_arcsec_px;
  const [unit, k] = route.value.query.get("unit") === "arcsec" && scale ? ["″", scale] : ["px", 1];
  const over = (value) => broken(past.corrections.map((one) => [Date.parse(one.mid_utc), value(one) ?? null]));
  const error = (one, name) => (Number.isFinite(one[name]?.error_px) ? k * one[name].error_px : null);
  const out = past.corrections.filter((one) => isOut(one, "east") || isOut(one, "north")).length;
  /** Of one axis without outliers, and beside it with them. */
  const figure = (name) => ({ value: fixed(rms(past.corrections.filter((one) => !isOut(one, name)).map((one) => error(one, name)))), sub: past.corrections.some((one) => isOut(one, name)) ? `with outliers ${fixed(rms(past.corrections.map((one) => error(one, name))))} ${unit}` : null });
  const pulse = (value) => (Number.isFinite(value) ? `${value > 0 ? "+" : ""}${number(value, 0)}` : "—");
  return html`${entry ? html`<${Now} entry=${entry} />` : html`<p class="m">Nothing of guiding received yet.</p>`}
    <div class="grid g-side"><${Card} name="Error and what was sent" end=${html`${scale && html`<${Segment} label="Unit of errors" options=${[["px", "px"], ["″", "″"]]} value=${unit} onChange=${(value) => go(withQuery({ unit: value === "″" ? "arcsec" : null }), { replace: true })} /> `}<${Segment} label="How far back" options=${HOURS} value=${hours} onChange=${choose} />`}><${Loaded} of=${past} what="The past of guiding">${() => past.corrections.length ? html`<${Chart} key=${unit} t0=${past.t0} t1=${past.t1} now=${past.t1} panels=${[
      { name: "Error", unit, digits: 2, height: 170, limits: [], series: [{ name: "east", points: over((one) => error(one, "east")), colour: "--s1", kind: "dots" }, { name: "north", points: over((one) => error(one, "north")), colour: "--s2", kind: "dots" }] },
      { name: "Pulse", unit: "ms", digits: 0, height: 110, zero: false, series: [{ name: "east", points: over((one) => one.east?.given_ms), colour: "--s1", stepped: true }, { name: "north", points: over((one) => one.north?.given_ms), colour: "--s2", stepped: true }] },
      { name: "FWHM", unit: "px", digits: 2, height: 80, series: [{ name: "", points: over((one) => one.fwhm_px), colour: "--s4" }] },
      { name: "Stars used", unit: "", digits: 0, height: 70, zero: true, series: [{ name: "", points: over((one) => one.stars), colour: "--s4" }] }]} />` : html`<${Empty} icon="guide" title="No frame was guided on in this time" />`}<//><//>
      <div class="stack"><${Card} name="Where the star went" end=${html`<${Old} of=${past} />${HOURS.find(([one]) => one === hours)[1]}, ${unit}, equal axes`}><${Plane} equal key=${unit} label=${`East against north, ${unit}`} xName=${`east, ${unit}`} yName="north" points=${past.corrections.map((one) => ({ x: error(one, "east"), y: error(one, "north") ?? NaN, kind: isOut(one, "east") || isOut(one, "north") ? "cross" : one.pier_side === "west" ? "ring" : "dot", title: clock(one.mid_utc) })).filter((point) => Number.isFinite(point.x + point.y))}
          table=${() => ({ heads: [{ name: "Time", unit: "UTC", isTime: true }, { name: "East", unit, digits: 2 }, { name: "North", unit, digits: 2 }, { name: "Pier side" }], rows: past.corrections.map((one) => [Date.parse(one.mid_utc), error(one, "east"), error(one, "north"), one.pier_side ?? null]).reverse() })} />
        <div class="read"><span class="key dot">pier side east</span><span class="key ring">pier side west</span>${out > 0 && html`<span>× outlier: not in the RMS</span>`}</div>
        <div class="stats three"><${Stat} name="RMS east" ...${figure("east")} unit=${unit} /><${Stat} name="RMS north" ...${figure("north")} unit=${unit} /><${Stat} name="Frames" value=${past.data && past.corrections.length} sub=${past.truncated ? "the newest only" : null} /></div><//>
        ${entry && html`<${Calibration} body=${entry.body} />`}</div></div>
    <${Card} name="Last corrections" flush end=${html`<${Old} of=${past} />errors in ${unit}, pulses in ms`}><${Table} label="Last corrections" columns=${columns(unit)} rows=${newest} keyOf=${(one) => one.frame} cells=${(one) => html`<td class="mono mm"><a href=${`/t/${id}/frames/${encodeURIComponent(one.frame)}`}>${clock(one.mid_utc)}</a></td><td class="num"><b>${fixed(error(one, "east")) ?? "—"}</b></td><td class="num">${pulse(one.east?.given_ms)}</td><td>${words(one.east?.why)}</td>
      <td class="num"><b>${fixed(error(one, "north")) ?? "—"}</b></td><td class="num">${pulse(one.north?.given_ms)}</td><td>${words(one.north?.why)}</td><td class="num hidep">${one.stars ?? "—"}</td>`} /><//>`;
}
const fixed = (value) => (Number.isFinite(value) ? number(value, 2) : null);
