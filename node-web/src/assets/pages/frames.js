// Frames: a search in the archive, as pictures or as a table.
import { html, signal, useEffect, useSignal } from "../lib.js";
import { useGet } from "../api.js";
import { clock, nightDay, nightOf, number, plain } from "../format.js";
import { Card, Empty, Icon, Loaded, Segment, Table } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { tonight } from "../site.js";
import { net, skyNow, tick } from "../store.js";

const FILTERS = ["night", "object", "filter", "image_type", "fwhm_max_arcsec", "stars_min"];
const MOST = 300;
const DAY_MS = 86400e3;

/** What is worth a word about a frame. */
export const flaw = (frame) => [frame.trailed && "trailed", frame.header_complete === false && "header incomplete"].filter(Boolean).join(", ");

/** @type {any} The frame that was opened from a list, and the list's address: whoever comes back is at that frame again. */
export const came = signal(null);
const open = (frame) => () => { came.value = { frame: frame.id, href: location.pathname + location.search }; };

/** Arrow keys go from frame to frame. */
function step(event) {
  const side = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -1, ArrowDown: 1 }[event.key];
  const all = [...event.currentTarget.querySelectorAll("[data-open]")];
  const at = all.indexOf(document.activeElement);
  if (!side || at < 0 || event.shiftKey || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  all[Math.max(0, Math.min(all.length - 1, at + side))].focus();
}

const RETRY_MS = 1500;

function Thumb({ id, frame }) {
  // The archive answers a few questions at a time: a picture that is refused is asked for again.
  const again = (event) => {
    const image = event.target;
    const tries = Number(image.dataset.tries ?? 0) + 1;
    image.dataset.tries = String(tries);
    const { src } = image;
    if (tries < 8) setTimeout(() => { image.removeAttribute("src"); image.src = src; }, RETRY_MS * (1 + Math.random()));
  };
  return html`<a class="card frame-card" href=${`/t/${id}/frames/${encodeURIComponent(frame.id)}`} data-testid="frame" data-frame=${frame.id} data-open=${frame.id} onClick=${open(frame)}><span class="thumb"><img loading="lazy" onError=${again} alt=${`${frame.image_type} ${frame.object ?? ""}`} width="200" height="200" src=${`/api/v1/telescopes/${id}/frames/${encodeURIComponent(frame.id)}/preview?size=256`} /></span>
    <span class="about"><span class="row between"><b class="cut">${frame.object ?? frame.image_type}</b><span class="mm nw">${clock(frame.at_utc)}</span></span><span class="row between"><span class="m cut">${frame.filter ?? "no filter"} ${plain(frame.exposure_s)} s</span>${flaw(frame) && html`<span class="ink-p3 nw">▼ ${flaw(frame)}</span>`}</span>
      <span class="facts"><span>FWHM</span><span>stars</span><span>sky</span><span class="m">${frame.fwhm_arcsec != null ? `${number(frame.fwhm_arcsec, 2)}″` : "—"}</span><span class="m">${frame.stars ?? "—"}</span><span class="m">${frame.sky_adu != null ? number(frame.sky_adu, 0) : "—"}</span></span></span></a>`;
}

const COLUMNS = [{ key: "t", name: "Begun", sort: (frame) => frame.at_utc }, { key: "o", name: "Target", sort: (frame) => frame.object ?? "" }, { key: "y", name: "Type", sort: (frame) => frame.image_type, cls: "hidep" }, { key: "f", name: "Filter", sort: (frame) => frame.filter ?? "" }, { key: "e", name: "Exposure", num: true, sort: (frame) => frame.exposure_s },
  { key: "w", name: "FWHM", num: true, falls: true, sort: (frame) => frame.fwhm_arcsec }, { key: "s", name: "Stars", num: true, sort: (frame) => frame.stars }, { key: "k", name: "Sky, ADU", num: true, cls: "hidep", sort: (frame) => frame.sky_adu }, { key: "n", name: "File", cls: "hidep" }, { key: "x", name: "" }];

function Found({ id, view, data, text }) {
  const frames = (data.rows ?? []).map((row) => row.found_frame).filter(Boolean).sort((a, b) => (a.at_utc < b.at_utc ? 1 : -1)).filter((frame) => `${frame.object ?? ""} ${frame.file} ${frame.filter ?? ""} ${frame.image_type}`.toLowerCase().includes(text.toLowerCase()));
  useEffect(() => {
    const back = came.peek() && [...document.querySelectorAll("[data-open]")].find((one) => /** @type {any} */ (one).dataset.open === came.peek().frame);
    if (!back) return;
    came.value = null;
    /** @type {any} */ (back).focus();
  }, [data]);
  if (!frames.length) return html`<${Empty} icon="image" title=${data.truncated ? `None of the newest ${data.rows.length} fits` : "No frame fits"}>${data.truncated ? "There are older ones: name the target exactly." : "Choose another night, or fewer conditions."}<//>`;
  return html`${view === "grid" ? html`<div class="frame-grid" onKeyDown=${step}>${frames.map((frame) => html`<${Thumb} key=${frame.id} id=${id} frame=${frame} />`)}</div>` : html`<div onKeyDown=${step}><${Card} flush label="Frames"><${Table} label="Frames" columns=${COLUMNS} rows=${frames} keyOf=${(frame) => frame.id} rowProps=${(frame) => ({ "data-testid": "frame", "data-frame": frame.id })}
      cells=${(frame) => html`<td class="k"><a href=${`/t/${id}/frames/${encodeURIComponent(frame.id)}`} data-open=${frame.id} onClick=${open(frame)}>${clock(frame.at_utc)}</a></td><td>${frame.object ?? "—"}</td><td class="hidep">${frame.image_type}</td><td>${frame.filter ?? "—"}</td><td class="num">${plain(frame.exposure_s)} s</td><td class="num">${frame.fwhm_arcsec != null ? `${number(frame.fwhm_arcsec, 2)}″` : "—"}</td><td class="num">${frame.stars ?? "—"}</td>
        <td class="num hidep">${frame.sky_adu != null ? number(frame.sky_adu, 0) : "—"}</td><td class="hidep mono mm">${frame.file}</td><td>${flaw(frame) && html`<span class="ink-p3">▼ ${flaw(frame)}</span>`}</td>`} /><//></div>`}`;
}

export function Frames({ id }) {
  const { query } = route.value;
  const view = query.get("view") === "list" ? "list" : "grid";
  const text = useSignal("");
  const telescopes = [...net.value.values()].filter((one) => !one.shared);
  const chosen = id ?? query.get("telescope") ?? telescopes[0]?.id;
  const conditions = new URLSearchParams();
  for (const name of FILTERS) if (query.get(name)) conditions.set(name, query.get(name));
  if (!conditions.has("night") && skyNow()) conditions.set("night", tonight(net.value.get(chosen)));
  conditions.set("limit", String(MOST));
  const found = useGet(chosen && skyNow() && `/api/v1/telescopes/${chosen}/frames?${conditions}`, 60);
  if (!skyNow()) tick.value; // eslint-disable-line no-unused-expressions -- until the first message
  const set = (name) => (event) => go(withQuery({ [name]: event.target.value || null }), { replace: true });
  const night = conditions.get("night") ?? "";
  const beside = (step) => () => go(withQuery({ night: nightOf(Date.parse(`${night.slice(0, 4)}-${night.slice(4, 6)}-${night.slice(6, 8)}T13:00:00Z`) + step * DAY_MS) }));
  return html`<div class="page-h">${id ? html`<h2>Frames</h2>` : html`<h1 tabindex="-1">Frames</h1>`}<span class="m">${found.data ? `${found.data.rows?.length ?? 0}${found.data.truncated ? " and more" : ""}` : ""} ${night && `of the night of ${nightDay(night)}`}</span><span class="grow"></span>${[["Night before", -1, "left"], ["Night after", 1, "chev"]].map(([word, step, icon]) => html`<button key=${word} class="btn sm soft" aria-label=${word} disabled=${!night} onClick=${beside(step)}><${Icon} name=${icon} /></button>`)}<${Segment} label="View" options=${[["grid", "Grid"], ["list", "List"]]} value=${view} onChange=${(value) => go(withQuery({ view: value === "grid" ? null : value }), { replace: true })} /></div>
    <div class="row wrap chips-x"><label class="in"><${Icon} name="search" /><input type="search" placeholder="Target, file" aria-label="Search frames" onInput=${(event) => { text.value = event.target.value; }} /><kbd>/</kbd></label>
      ${!id && html`<label class="in"><select aria-label="Telescope" onChange=${set("telescope")}>${telescopes.map((one) => html`<option key=${one.id} value=${one.id} selected=${one.id === chosen}>${one.id}</option>`)}</select></label>`}
      <label class="in">Night <input type="date" aria-label="Night, by its evening" value=${night && `${night.slice(0, 4)}-${night.slice(4, 6)}-${night.slice(6)}`} onChange=${(event) => go(withQuery({ night: event.target.value.replaceAll("-", "") || null }), { replace: true })} /></label>
      <label class="in"><select aria-label="Type" onChange=${set("image_type")}>${[["", "Any type"], ["light", "Light"], ["acquisition", "Acquisition"], ["flat", "Flat"], ["dark", "Dark"], ["bias", "Bias"], ["test", "Test"]].map(([value, word]) => html`<option key=${value} value=${value} selected=${(query.get("image_type") ?? "") === value}>${word}</option>`)}</select></label>
      <label class="in"><input placeholder="Exact target" aria-label="Exact target" value=${query.get("object") ?? ""} onChange=${set("object")} /></label><label class="in"><input placeholder="Filter" aria-label="Filter" value=${query.get("filter") ?? ""} onChange=${set("filter")} size="6" /></label>
      <label class="in">FWHM below <input type="number" step="0.1" min="0" aria-label="FWHM below, arcsec" value=${query.get("fwhm_max_arcsec") ?? ""} onChange=${set("fwhm_max_arcsec")} /><span class="u">″</span></label></div>
    ${chosen ? html`<${Loaded} of=${found} what="The list of frames">${(data) => html`<${Found} id=${chosen} view=${view} data=${data} text=${text.value} />`}<//>` : html`<${Empty} icon="image" title="No telescope yet" />`}`;
}
