// The light curve of tonight's target against its comparison stars, with FWHM, sky, drift and airmass on one cursor, and the frame of that moment.
import { html, useEffect, useSignal } from "../lib.js";
import { useGet, useReport } from "../api.js";
import { Chart, broken } from "../chart.js";
import { clock, hourMinute, number } from "../format.js";
import { Card, Cut, Empty, Loaded, Old, Stat } from "../parts.js";
import { tonight } from "../site.js";

const median = (values) => { const sorted = [...values].sort((a, b) => a - b); return sorted.length ? sorted[Math.floor(sorted.length / 2)] : null; };
const scatter = (values) => { const middle = median(values); return middle === null ? null : 1.4826 * median(values.map((value) => Math.abs(value - middle))); };

/** Means over `binS` seconds. */
function binned(points, binS) {
  const bins = new Map();
  for (const [t, value] of points) {
    const bin = Math.floor(t / 1000 / binS);
    bins.set(bin, [...(bins.get(bin) ?? []), value]);
  }
  return [...bins].sort(([a], [b]) => a - b).map(([bin, values]) => [(bin + 0.5) * binS * 1000, values.reduce((sum, value) => sum + value, 0) / values.length]);
}

const FILM = 9;
/** A cursor that has not moved for so long is at rest, ms. */
const REST_MS = 300;

/** Frames around the moment of the cursor, once it rests. */
function Film({ id, frames, moment }) {
  const rest = useSignal(moment);
  useEffect(() => {
    const timer = setTimeout(() => { rest.value = moment; }, REST_MS);
    return () => clearTimeout(timer);
  }, [moment]);
  const sorted = [...frames].sort((a, b) => (a.at_utc < b.at_utc ? -1 : 1));
  const nearest = sorted.reduce((best, one, i) => (Math.abs(Date.parse(one.at_utc) - rest.value) < Math.abs(Date.parse(sorted[best].at_utc) - rest.value) ? i : best), 0);
  // The film moves on by whole pieces: a cursor that goes to the neighbour asks for no new picture.
  const first = Math.max(0, Math.min(Math.floor(nearest / FILM) * FILM, sorted.length - FILM));
  return sorted.length > 1 && html`<nav class="film" aria-label="Frames around the cursor">${sorted.slice(first, first + FILM).map((frame, i) => html`<a key=${frame.id} href=${`/t/${id}/frames/${encodeURIComponent(frame.id)}`} aria-current=${first + i === nearest ? "true" : null}><span class="thumb"><img loading="lazy" alt="" width="96" height="96" src=${`/api/v1/telescopes/${id}/frames/${encodeURIComponent(frame.id)}/preview?size=96`} /></span><small>${hourMinute(frame.at_utc)}</small></a>`)}</nav>`;
}

function Curve({ id, curve, frames, list }) {
  const at = useSignal(null);
  const middle = median(curve.points.map((point) => point.flux).filter(Number.isFinite)) || 1;
  const of = (field) => broken(curve.points.map((point) => [Date.parse(point.mid_utc), Number.isFinite(point[field]) ? point[field] : null]));
  const flux = curve.points.map((point) => [Date.parse(point.mid_utc), Number.isFinite(point.flux) ? (point.flux / middle - 1) * 1000 : null]);
  const known = flux.filter(([, value]) => value !== null);
  const [t0, t1] = [Math.min(...flux.map(([t]) => t)) - 3e5, Math.max(...flux.map(([t]) => t)) + 3e5];
  const cadence = median(flux.slice(1).map(([t], i) => (t - flux[i][0]) / 1000));
  const moment = at.value ?? flux[flux.length - 1]?.[0];
  const point = curve.points.reduce((best, one) => (!best || Math.abs(Date.parse(one.mid_utc) - moment) < Math.abs(Date.parse(best.mid_utc) - moment) ? one : best), null);
  const film = frames.filter((frame) => frame.object === curve.object && frame.filter === curve.filter);
  const shown = film.reduce((best, one) => (!best || Math.abs(Date.parse(one.at_utc) - moment) < Math.abs(Date.parse(best.at_utc) - moment) ? one : best), null);
  return html`<div class="grid g-side"><${Card} name=${`${curve.object}, ${curve.filter ?? "no filter"}`} end=${`${curve.points.length} frames, ${curve.comparison_stars} comparison stars`}><${Chart} t0=${t0} t1=${t1} onAt=${(t) => { at.value = t; }} panels=${[
      { name: "Flux against its median", unit: "ppt", digits: 1, height: 200, series: [{ name: "each frame", head: "Flux against its median", points: flux, colour: "--s1", kind: "dots" }, { name: "5 min", head: "Mean of 5 min", points: broken(binned(known, 300)), colour: "--s4" }] },
      { name: "FWHM", unit: "″", digits: 2, height: 70, series: [{ name: "", points: of("fwhm_arcsec"), colour: "--s4" }] }, { name: "Sky", unit: "ADU", digits: 0, height: 70, series: [{ name: "", points: of("sky_adu"), colour: "--s4" }] },
      { name: "Drift", unit: "px", digits: 2, height: 80, series: [{ name: "x", points: of("dx_px"), colour: "--s1" }, { name: "y", points: of("dy_px"), colour: "--s2" }] }, { name: "Airmass", unit: "", digits: 2, height: 60, series: [{ name: "", points: of("airmass"), colour: "--s4" }] }]} />
    <${Film} id=${id} frames=${film} moment=${moment} /><${Cut} of=${list.data} />
    ${curve.warnings?.length > 0 && curve.warnings.map((text, i) => html`<p class="note p3" key=${i}>${typeof text === "string" ? text : JSON.stringify(text)}</p>`)}<//>
    <div class="stack"><${Card} name="At the cursor" end=${html`<${Old} of=${list} />${point && clock(point.mid_utc)}`}>${shown && html`<a class="img" href=${`/t/${id}/frames/${encodeURIComponent(shown.id)}`} aria-label="Open this frame"><img alt=${`Frame of ${clock(shown.at_utc)}`} src=${`/api/v1/telescopes/${id}/frames/${encodeURIComponent(shown.id)}/preview?size=384`} width="384" height="384" /></a>`}
      ${point && html`<dl class="kv"><dt>Flux</dt><dd><b>${number((point.flux / middle - 1) * 1000)}</b> ± ${number((point.flux_error / middle) * 1000)} ppt</dd><dt>FWHM</dt><dd>${point.fwhm_arcsec != null ? `${number(point.fwhm_arcsec, 2)}″` : "—"}</dd><dt>Sky</dt><dd>${point.sky_adu != null ? `${number(point.sky_adu, 0)} ADU` : "—"}</dd><dt>Airmass</dt><dd>${point.airmass != null ? number(point.airmass, 3) : "—"}</dd></dl>
        <a class="btn sm quiet" href=${`/t/${id}/log?at=${encodeURIComponent(point.mid_utc)}`}>Log here</a>`}<//>
      <${Card} name="Quality"><div class="stats two"><${Stat} name="Scatter of a frame" value=${known.length ? number(scatter(known.map(([, value]) => value)), 1) : null} unit="ppt" /><${Stat} name="Over 5 min" value=${known.length ? number(scatter(binned(known, 300).map(([, value]) => value)), 2) : null} unit="ppt" /><${Stat} name="Cadence" value=${cadence === null ? null : number(cadence, 0)} unit="s" /><${Stat} name="Left out" value=${curve.frames_left_out} /></div>
        <p class="tagline">${curve.variable_stars > 0 ? `${curve.variable_stars} stars vary and are left out.` : ""} These curves show how a night goes; they are not for papers.</p><//></div></div>`;
}

export function LightCurve({ id, summary }) {
  const night = tonight(summary);
  const report = useReport(id, night);
  const list = useGet(night && `/api/v1/telescopes/${id}/frames?night=${night}&image_type=light&limit=2000`, 60);
  const chosen = useSignal(null);
  const frames = (list.data?.rows ?? []).map((row) => row.found_frame).filter(Boolean);
  return html`<${Loaded} of=${report} what="The night">${(data) => {
    const curves = (data.curves ?? []).filter((curve) => curve.points?.length);
    if (!curves.length) return html`<${Empty} icon="curve" title="No light curve yet">A target needs some measured frames with comparison stars.<//>`;
    const name = (curve) => `${curve.object} ${curve.filter ?? ""} ${curve.camera}`;
    const curve = curves.find((one) => name(one) === chosen.value) ?? curves[curves.length - 1];
    return html`${curves.length > 1 && html`<div class="row wrap">${curves.map((one) => html`<button key=${name(one)} class="chip" aria-pressed=${String(one === curve)} onClick=${() => { chosen.value = name(one); }}>${one.object} ${one.filter ?? ""}</button>`)}</div>`}<${Curve} key=${name(curve)} id=${id} curve=${curve} frames=${frames} list=${list} />`;
  }}<//>`;
}
