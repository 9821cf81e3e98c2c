// Focus: the run that goes on or the last one, with its points and curve; positions by temperature; FWHM of the night's frames.
import { html, useMemo } from "../lib.js";
import { useGet, useReport } from "../api.js";
import { Chart } from "../chart.js";
import { clock, number, plain } from "../format.js";
import { Age, Card, Empty, Loaded, Stat, Table } from "../parts.js";
import { Plane } from "../plane.js";
import { tonight } from "../site.js";
import { ageOf, moment, quality, skyNow, tick, useTopic } from "../store.js";

const words = (value) => String(value ?? "—").replaceAll("_", " ");

/** Points of a run, and its fitted curve where it has one. */
function Run({ run, unit }) {
  const points = (run.points ?? []).map((point) => ({ x: point.position, y: point.value, error: point.error, kind: point.value == null ? "cross" : point.pass === "coarse" ? "hollow" : "dot", title: `${point.position}: ${point.value == null ? point.reason ?? "not measured" : number(point.value, 2)}` }));
  const curve = run.curve;
  const known = points.filter((point) => Number.isFinite(point.y));
  const lines = [];
  if (curve && /hyperbola/.test(curve.model ?? "hyperbola") && Number.isFinite(curve.best_position) && Number.isFinite(curve.best_value) && Number.isFinite(curve.slope_per_step) && known.length) {
    const [low, high] = [Math.min(...known.map((p) => p.x)), Math.max(...known.map((p) => p.x))];
    lines.push(Array.from({ length: 61 }, (_, i) => { const x = low + ((high - low) * i) / 60; return [x, Math.hypot(curve.best_value, curve.slope_per_step * (x - curve.best_position))]; }));
  }
  if (curve && Array.isArray(curve.places) && curve.places.length > 1) lines.push(curve.places);
  if (!known.length) return html`<${Empty} icon="focus" title="No point of this run could be measured">${run.reason ?? ""}<//>`;
  return html`<${Plane} width=${620} height=${320} label="Size of stars against the focuser's position" xName="position, steps" yName=${unit} points=${points} lines=${lines} best=${run.best_position ?? null} zone=${run.critical_zone && run.best_position != null ? [run.best_position - run.critical_zone, run.best_position + run.critical_zone] : null}
    table=${() => ({ heads: [{ name: "Position", unit: "steps", digits: 0 }, { name: unit, digits: 2 }, { name: "Error", digits: 2 }, { name: "Stars", digits: 0 }, { name: "Pass" }, { name: "Not measured because" }], rows: (run.points ?? []).map((point) => [point.position, point.value ?? null, point.error ?? null, point.stars ?? null, words(point.pass), point.value == null ? point.reason ?? "not told" : ""]) })} />`;
}

/** A slope of less than so many runs is drawn by chance. */
const ENOUGH_RUNS = 3;

/** The best positions of remembered runs by the temperature, without their filters' offsets. */
function ByTemperature({ found, focuser }) {
  const points = found.filter((run) => Number.isFinite(run.temperature_c) && Number.isFinite(run.position)).map((run) => ({ x: run.temperature_c, y: run.position - (run.wheel_offset ?? 0), error: run.error, kind: "dot", at: Date.parse(run.at_utc), title: `${clock(run.at_utc)}, ${run.filter ?? "no filter"}` }));
  if (points.length < ENOUGH_RUNS) return null;
  const mean = (name) => points.reduce((sum, point) => sum + point[name], 0) / points.length;
  const [x, y, slope] = [mean("x"), mean("y"), focuser.steps_per_c];
  const ends = [Math.min(...points.map((point) => point.x)), Math.max(...points.map((point) => point.x))];
  return html`<${Card} name="Best position against temperature" testid="temperature" end=${html`${points.length} runs of ${focuser.focuser}${slope != null && html`, <b>${number(slope)}</b>${focuser.steps_per_c_error != null ? ` ± ${number(focuser.steps_per_c_error)}` : ""} steps/°C`}`}><${Plane} width=${620} height=${254} label=${`Best position of ${focuser.focuser} against temperature`} xName="at the focuser, °C" yName="steps" points=${points} lines=${slope == null ? [] : [ends.map((at) => [at, y + slope * (at - x)])]}
    table=${() => ({ heads: [{ name: "Time", unit: "UTC", isTime: true }, { name: "Temperature", unit: "°C", digits: 1 }, { name: "Best position", unit: "steps", digits: 0 }], rows: points.map((point) => [point.at, point.x, point.y]).reverse() })} /><//>`;
}

const COLUMNS = [{ key: "t", name: "Started" }, { key: "f", name: "Filter" }, { key: "p", name: "Points", num: true }, { key: "b", name: "Best, steps", num: true }, { key: "c", name: "Air, °C", num: true }, { key: "o", name: "Outcome" }];

export function Focus({ id, summary }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}/observatory/focus`);
  const entry = states?.get(`${id}/observatory/focus/state`);
  const learned = useTopic(`tel/${id}/observatory/focus-learned`)?.get(`${id}/observatory/focus-learned/state`)?.body.focusers ?? {};
  const night = tonight(summary);
  const report = useReport(id, night);
  const frames = useGet(night && `/api/v1/telescopes/${id}/frames?night=${night}&image_type=light&limit=2000`, 60);
  const t1 = useMemo(() => skyNow(), [frames.at, Math.floor((moment.value ?? 0) / 60e3)]);
  const points = (frames.data?.rows ?? []).map((row) => row.found_frame).filter((frame) => frame?.fwhm_arcsec != null).map((frame) => [Date.parse(frame.at_utc), frame.fwhm_arcsec]);
  const runs = report.data?.focus_runs ?? [];
  const body = entry?.body;
  const worth = entry && quality(ageOf(entry), entry.period_s);
  const run = body?.run ?? runs[runs.length - 1];
  return html`${entry ? html`<div class="grid g-side"><${Card} name=${run?.started_utc ? `Run of ${clock(run.started_utc)}` : "The last run"} end=${html`${run?.points?.length > 0 && html`<span class="key ring hollow">coarse</span><span class="key dot">fine</span><span>× not measured</span>${run.curve ? html`<span class="key">${words(run.curve.model)}</span>` : run.outcome !== "running" && html`<span>no curve</span>`}${run.critical_zone && html`<span class="desk">hatched: critical zone</span>`}`}${body.active && worth === "fresh" && html`<span class="mode">RUNNING</span>`}`}>${run?.points?.length ? html`<${Run} run=${run} unit=${words(run.value_label ?? "size of stars, px")} />${run.outcome === "failed" && html`<p class="note p3" data-testid="run-failed"><span class="grow"><b>No focus.</b> ${run.reason ?? "The run does not say why."}</span></p>`}` : html`<${Empty} icon="focus" title="No focus run since this node started" />`}<//>
      <div class="stack"><${Card} name="Now"><div class="stats three"><${Stat} name="Best position" value=${plain(body.best_position)} unit="steps" worth=${worth} />${(body.focusers ?? []).map((one) => html`<${Stat} key=${one.focuser} name=${one.focuser} value=${plain(one.best_position)} unit="steps" sub=${[one.temperature_c != null && `at ${number(one.temperature_c)} °C`, one.runs != null && `${one.runs} runs`, one.steps_per_c != null && `${number(one.steps_per_c)} steps/°C`].filter(Boolean).join(", ")} />`)}</div>
        <p class="m">${body.detail} · ${run?.critical_zone ? `critical zone ± ${number(run.critical_zone, 0)} steps · ` : ""}<${Age} s=${ageOf(entry)} worth=${worth} after=" ago" /></p><//>
      <${Card} name="If a run fails"><p class="m">The focuser returns to the last good position, and the row goes on. The alert <span class="mono">focus-failed</span> says why.</p><//></div></div>` : html`<p class="m">Nothing of the focus received yet.</p>`}
    ${(body?.focusers ?? []).map((one) => html`<${ByTemperature} key=${one.focuser} found=${learned[one.focuser] ?? []} focuser=${one} />`)}
    <${Card} name="FWHM of tonight's frames"><${Loaded} of=${frames} what="The list of frames">${() => (points.length ? html`<${Chart} t0=${Math.min(...points.map(([t]) => t)) - 6e5} t1=${t1} now=${t1} marks=${runs.map((one) => ({ t: Date.parse(one.started_utc), text: "focus run" })).filter((mark) => mark.t)} panels=${[{ name: "FWHM", unit: "″", digits: 2, height: 180, zero: true, series: [{ name: "", points, colour: "--s1", kind: "dots" }] }]} />` : html`<${Empty} icon="focus" title="No frame of this night is measured yet" />`)}<//><//>
    <${Card} name="Runs tonight" flush><${Loaded} of=${report} what="The night">${() => (runs.length ? html`<${Table} label="Runs tonight" columns=${COLUMNS} rows=${runs} keyOf=${(one) => one.started_utc} cells=${(one) => html`<td class="k">${clock(one.started_utc)}</td><td>${one.filter ?? "—"}</td><td class="num">${one.points?.length ?? "—"}</td><td class="num"><b>${plain(one.best_position)}</b></td><td class="num">${one.temperature_c != null ? number(one.temperature_c) : "—"}</td><td>${words(one.outcome)}${one.reason ? `: ${one.reason}` : ""}</td>`} />` : html`<p class="m pad">No focus run tonight.</p>`)}<//><//>`;
}
