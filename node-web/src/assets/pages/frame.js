// One frame: its pixels with a stretch of one's own, what was measured, its whole header.
import { html, useEffect, useRef, useSignal } from "../lib.js";
import { Failure, useGet } from "../api.js";
import { bytes, clock, declination, number, plain, rightAscension } from "../format.js";
import { Card, Icon, Loaded, Old, Segment, Stat } from "../parts.js";
import { CURVES, Tiles, automatic, histogram } from "../pixels.js";
import { go, route } from "../route.js";
import { Viewer } from "../viewer.js";
import { came, flaw } from "./frames.js";

const BINS = 150;

function Histogram({ tile, stretch, onChange, tiles }) {
  const [low, high] = [Math.max(0, stretch.black - (stretch.white - stretch.black) * 0.15), stretch.white + (stretch.white - stretch.black) * 0.15];
  const counts = histogram(tile, low, high, BINS);
  const most = Math.log1p(Math.max(...counts, 1));
  const x = (value) => ((value - low) / (high - low)) * 300;
  const bars = [...counts].map((count, i) => `M${(i * 300) / BINS} 84V${(84 - (Math.log1p(count) / most) * 80).toFixed(1)}`).join("");
  const field = (name, label) => html`<div class="field"><label for=${name}>${label}</label><div class="in"><input id=${name} type="number" value=${Math.round(tiles.counts(stretch[name]))} onChange=${(event) => onChange({ [name]: (Number(event.target.value) - tiles.zero) / tiles.scale })} /><span class="u">ADU</span></div></div>`;
  return html`<svg class="hist" viewBox="0 0 300 84" preserveAspectRatio="none" role="img" aria-label="Histogram with black and white point"><path class="ln s4" d=${bars} stroke-width=${300 / BINS} /><path class="lim" d=${`M${x(stretch.black)} 0V84M${x(stretch.white)} 0V84`} /></svg>
    <div class="grid g2">${field("black", "Black")}${field("white", "White")}</div>`;
}

function Header({ id, frame }) {
  const header = useGet(`/api/v1/telescopes/${id}/frames/${encodeURIComponent(frame)}/header`);
  const text = useSignal("");
  return html`<${Card} name="Header" flush end=${html`<label class="in"><${Icon} name="search" /><input type="search" placeholder="Find" aria-label="Find in the header" onInput=${(event) => { text.value = event.target.value; }} /></label>`}>
    <${Loaded} of=${header} what="The header">${(data) => html`<div class="scroll" tabindex="0" role="group" aria-label="FITS header"><table class="fits" data-testid="header"><tbody>${data.hdus.flatMap((hdu) => hdu.cards.map((card, i) => [`${hdu.number} ${i}`, card])).filter(([, card]) => `${card.keyword} ${plain(card.value)} ${card.comment ?? ""}`.toLowerCase().includes(text.value.toLowerCase())).map(([key, card]) =>
      html`<tr key=${key}><td class="mono mm">${card.keyword}</td><td class="mono">${card.value === null ? "" : typeof card.value === "string" ? `'${card.value}'` : String(card.value)}</td><td class="mm">${card.comment}</td></tr>`)}</tbody></table></div>`}<//><//>`;
}

/** Tiles of a frame with its first one, which is the whole frame. */
async function readWhole(id, frame) {
  const tiles = new Tiles(id, frame);
  const whole = await tiles.get(0, 0, 0);
  if (!whole) throw new Failure(404, { detail: "The archive has no pixels of this frame." });
  return { tiles, whole };
}

/** Why tiles are missing; they are asked for again by another `again`, later each time. */
function useMissing() {
  const missing = useSignal({ error: null, tries: 0 });
  const again = useSignal(0);
  useEffect(() => {
    if (!missing.value.error) return undefined;
    const timer = setTimeout(() => {
      if (document.visibilityState === "visible") again.value += 1;
      else missing.value = { ...missing.peek() };
    }, Math.min(60, 2 ** missing.value.tries) * 1000);
    return () => clearTimeout(timer);
  }, [missing.value]);
  const onRead = (error) => {
    const { error: before, tries } = missing.peek();
    if (error || before) missing.value = error ? { error, tries: tries + 1 } : { error: null, tries: 0 };
  };
  return { error: missing.value.error, again: again.value, onRead, retry: () => { again.value += 1; } };
}

/** While nothing is written into and no dialog is open: what a key does. */
function useKey(key, action) {
  const latest = useRef(action);
  latest.current = action;
  useEffect(() => {
    const press = (event) => {
      if (event.key !== key || event.repeat || event.ctrlKey || event.metaKey || event.altKey || /input|textarea|select/i.test(event.target.tagName) || document.querySelector("dialog[open]")) return;
      latest.current();
    };
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  }, [key]);
}

/** What comes late has its place beforehand, over the picture or below it: the frame stays where somebody points at it. */
function Pixels({ id, frame, before }) {
  const found = useGet(`/api/v1/telescopes/${id}/frames/${encodeURIComponent(frame.id)}/tiles/0/0/0`, 0, { read: () => readWhole(id, frame.id) });
  const missing = useMissing();
  const stretch = useSignal(null);
  const zoom = useSignal("fit");
  const layers = useSignal(new Set(["target"]));
  const { tiles, whole } = found.data ?? {};
  const blinks = useSignal(false);
  const other = useGet(blinks.value && before ? `/api/v1/telescopes/${id}/frames/${encodeURIComponent(before)}/tiles/0/0/0` : null, 0, { read: () => readWhole(id, before) });
  const blink = () => { blinks.value = Boolean(before) && !blinks.peek(); };
  useKey("b", blink);
  const shown = blinks.value && other.data ? other.data.tiles : tiles;
  useEffect(() => {
    if (whole && !stretch.peek()) stretch.value = { ...automatic(whole, tiles.blank), curve: "asinh", invert: false };
  }, [whole]);
  const change = (part) => { stretch.value = { ...stretch.peek(), ...part }; };
  const toggle = (layer) => () => { const next = new Set(layers.peek()); if (!next.delete(layer)) next.add(layer); layers.value = next; };
  if (!whole || !stretch.value) return html`<${Card} name="Pixels"><${Loaded} of=${found} what="The pixels">${() => html`<p class="m">Reading pixels …</p>`}<//><//>`;
  const { facts } = frame;
  return html`<section class="stack"><div class="card flush"><div class="row wrap bar-of-tools"><${Segment} label="Stretch" options=${Object.keys(CURVES).map((curve) => [curve, curve])} value=${stretch.value.curve} onChange=${(curve) => change({ curve })} /><${Segment} label="Zoom" options=${[["fit", "Fit"], ["1", "1:1"], ["4", "4:1"]]} value=${zoom.value} onChange=${(value) => { zoom.value = value; }} />
      <span class="row"><button class="chip" aria-pressed=${String(layers.value.has("grid"))} disabled=${!facts?.wcs} onClick=${toggle("grid")}><${Icon} name="grid" />Grid</button><button class="chip" aria-pressed=${String(layers.value.has("target"))} disabled=${!facts?.wcs} onClick=${toggle("target")}><${Icon} name="guide" />Centre</button>
        <button class="chip" aria-pressed=${String(stretch.value.invert)} onClick=${() => change({ invert: !stretch.peek().invert })}>Invert</button>
        <button class="chip" disabled=${!before} aria-pressed=${String(blinks.value)} aria-keyshortcuts="b" onClick=${blink}>Blink with previous</button></span></div>
      <div class="pixels"><${Viewer} tiles=${shown} width=${frame.width_px} height=${frame.height_px} stretch=${stretch.value} zoom=${zoom.value} layers=${layers.value} wcs=${shown === tiles ? facts?.wcs : null} target=${frame.ra_deg != null ? [frame.ra_deg, frame.dec_deg] : null} again=${missing.again} onRead=${missing.onRead} />
        ${missing.error && html`<p class="note p3" data-testid="missing-tiles"><span class="grow"><b>Some pixels cannot be read.</b> ${missing.error.message}</span><button type="button" class="btn sm soft" onClick=${missing.retry}>Try again</button></p>`}</div>
      ${(blinks.value || !facts?.wcs) && html`<p class="m pad">${blinks.value && html`<span role="status">${shown === tiles ? other.error?.message ?? "reading the previous frame …" : "the previous frame"}</span> `}${!facts?.wcs && html`<span data-testid="no-wcs">No grid and no places: ${facts ? facts.reason ?? "the frame is not solved" : "it is not measured yet"}.</span>`}</p>`}</div>
    <${Card} name="Stretch" end=${html`<button type="button" class="btn sm quiet" onClick=${() => change(automatic(whole, tiles.blank))}>Auto</button>`}><${Histogram} tile=${whole} stretch=${stretch.value} onChange=${change} tiles=${tiles} /><//></section>`;
}

function Measured({ frame, of }) {
  const facts = frame.facts ?? {};
  const value = (v, digits) => (v === null || v === undefined ? null : number(v, digits));
  return html`<${Card} name="Measured" end=${html`<${Old} of=${of} />${facts.measuring_s != null && `in ${number(facts.measuring_s, 2)} s`}`}><div class="stats three">
    <${Stat} name="FWHM" value=${value(facts.fwhm_px, 2)} unit="px" sub=${frame.fwhm_arcsec != null ? `${number(frame.fwhm_arcsec, 2)}″` : null} /><${Stat} name="Ellipticity" value=${value(facts.ellipticity, 2)} level=${facts.trailed ? "p3" : null} sub=${facts.trailed ? "trailed" : null} /><${Stat} name="Stars" value=${facts.stars} sub=${facts.matched != null ? `${facts.matched} matched` : null} />
    <${Stat} name="Sky" value=${value(facts.sky_adu, 0)} unit="ADU" sub=${facts.noise_adu != null ? `noise ${number(facts.noise_adu, 1)}` : null} /><${Stat} name="Zero point" value=${value(facts.zero_point_mag, 2)} unit="mag" sub=${facts.zero_point_error_mag != null ? `± ${number(facts.zero_point_error_mag, 3)}` : null} /><${Stat} name="Transparency" value=${value(facts.transparency, 2)} />
    <${Stat} name="Off target" value=${value(facts.off_target_arcmin, 2)} unit="′" /><${Stat} name="Scale" value=${value(facts.scale_arcsec_px, 3)} unit="″/px" /><${Stat} name="Rotation" value=${value(facts.rotation_deg, 2)} unit="°" /><${Stat} name="Airmass" value=${value(facts.airmass, 2)} /><${Stat} name="Pier side" value=${facts.pier_side} /><${Stat} name="Saturated" value=${facts.saturated_fraction != null ? number(100 * facts.saturated_fraction, 3) : null} unit="%" /><${Stat} name="Target" value=${{ true: "saturated", false: "not saturated" }[facts.target_saturated]} /></div>
    ${facts.ra_deg != null && html`<p class="m">Centre <b>${rightAscension(facts.ra_deg)} ${declination(facts.dec_deg)}</b></p>`}${facts.reason && html`<p class="note p3">${facts.reason}</p>`}<//>`;
}

const about = (frame) => `${frame.image_type}, ${frame.filter ?? "no filter"}, ${plain(frame.exposure_s)} s, begun ${clock(frame.at_utc)} UTC, ${frame.camera}`;

export function Frame({ id, summary }) {
  const wanted = route.value.rest[0];
  // It may be opened before the archive has it, and before it is measured.
  const found = useGet(`/api/v1/telescopes/${id}/frames/${encodeURIComponent(wanted)}`, 0, { whole: (frame) => Boolean(frame?.facts) });
  const night = found.data?.night;
  const list = useGet(night && `/api/v1/telescopes/${id}/frames?night=${night}&limit=1000`);
  const ids = (list.data?.rows ?? []).map((row) => row.found_frame?.id).filter(Boolean);
  const at = ids.indexOf(wanted);
  const beside = (step) => at >= 0 && ids[at + step];
  useKey("Escape", () => { came.value = { frame: wanted, href: came.peek()?.href ?? `/t/${id}/frames${night ? `?night=${night}` : ""}` }; go(came.peek().href); });
  // What is looked into stays; what has come since is a touch away.
  const newest = summary?.image;
  const isNewer = newest && newest.frame !== wanted && newest.started_utc > (found.data?.at_utc ?? "");
  const link = (step, name, icon) => html`<button class="btn sm soft" disabled=${!beside(step)} aria-label=${name} onClick=${() => go(`/t/${id}/frames/${encodeURIComponent(beside(step))}`)}><${Icon} name=${icon} /></button>`;
  return html`<${Loaded} of=${found.data ? { ...found, error: null } : found} what="The frame">${(frame) => html`<div class="page-h frame-h">${link(-1, "Previous frame", "left")}${link(1, "Next frame", "chev")}<h2>${frame.object ?? frame.image_type}</h2><span class="m" title=${about(frame)}>${about(frame)}</span>${flaw({ ...frame, ...frame.facts }) && html`<span class="pri p3">▼ ${flaw({ ...frame, ...frame.facts })}</span>`}<span class="grow"></span>
      ${isNewer && html`<a class="btn soft sm" data-testid="newest" href=${`/t/${id}/frames/${encodeURIComponent(newest.frame)}`}>Newest frame ${clock(newest.started_utc)}</a>`}<a class="btn soft sm" href=${`/api/v1/telescopes/${id}/frames/${encodeURIComponent(frame.id)}/file`} download><${Icon} name="down2" /><span>Download, ${bytes(frame.bytes)}</span></a></div>
    <div class="grid g-side"><${Pixels} id=${id} frame=${frame} before=${beside(-1) || null} key=${frame.id} /><div class="stack"><${Measured} frame=${frame} of=${found} /><${Header} id=${id} frame=${frame.id} key=${frame.id} /></div></div><p class="tagline mono">${frame.file}</p>`}<//>`;
}
