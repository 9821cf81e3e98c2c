// The sky as seen from below: north up, east left. Where the telescope points, the dome's slit, targets and the Moon.
import { html } from "./lib.js";
import { altaz, lst, moon, separation } from "./astro.js";
import { number } from "./format.js";

const [S, R] = [360, 150];
const C = S / 2;
/** @type {[string, number, number][]} */
const NAMES = [["N", 0, -R - 9], ["S", 0, R + 19], ["E", -R - 16, 4], ["W", R + 18, 4]];
const rad = Math.PI / 180;
const place = ({ alt, az }) => { const r = ((90 - alt) / 90) * R; return [C - r * Math.sin(az * rad), C - r * Math.cos(az * rad)]; };

/** What hills and walls hide: between the rim and the horizon, pairs of azimuth and altitude. */
const hides = (horizon) => `M${C} ${C - R}A${R} ${R} 0 1 0 ${C + 0.01} ${C - R}ZM${horizon.map(([az, alt]) => place({ az, alt: Math.max(0, alt) }).map((v) => v.toFixed(1)).join(" ")).join("L")}Z`;
const turned = (a, b) => Math.abs(((a - b + 540) % 360) - 180);
/** The horizon's altitude in the direction nearest to an azimuth. */
const horizonAt = (horizon, az) => horizon.reduce((best, one) => (turned(one[0], az) < turned(best[0], az) ? one : best))[1];

/** `mount` and `dome`: fields of their states; `targets`: `{ name, ra, dec }`; `site`: `{ lat, lon }`; `horizon`: pairs of azimuth and altitude, where it is known. */
export function SkyMap({ mount, dome, targets = [], site, now, horizon = null }) {
  const luna = moon(now);
  const moonAt = altaz(luna, now, site);
  const here = Number.isFinite(mount?.altitude_deg) && Number.isFinite(mount?.azimuth_deg) ? { alt: mount.altitude_deg, az: mount.azimuth_deg } : null;
  const away = here && Number.isFinite(mount.ra_deg) ? separation({ ra: mount.ra_deg, dec: mount.dec_deg }, luna) : null;
  const slit = Number.isFinite(dome?.azimuth_deg) && dome.shutter === "open" ? dome.azimuth_deg : null;
  const arc = (az, w, r) => { const [a, b] = [az - w, az + w].map((angle) => `${(C - r * Math.sin(angle * rad)).toFixed(1)} ${(C - r * Math.cos(angle * rad)).toFixed(1)}`); return `M${a}A${r} ${r} 0 0 0 ${b}`; };
  const [x, y] = here ? place(here) : [0, 0];
  const walls = Array.isArray(horizon) && horizon.length > 2 ? horizon : null;
  const hidden = here && walls && here.alt < horizonAt(walls, here.az);
  const sidereal = lst(now, site.lon) / 15;
  return html`<div class="sky-map chart"><svg viewBox=${`0 0 ${S} ${S}`} role="img" aria-label=${here ? `Sky map. The telescope points to altitude ${number(here.alt)} degrees, azimuth ${number(here.az)}${hidden ? ", below the horizon or the limit" : ""}.` : "Sky map; where the telescope points is not known"}>
    <circle class="frame-bg" cx=${C} cy=${C} r=${R} />${walls && html`<path class="limzone" fill-rule="evenodd" d=${hides(walls)} />`}${[30, 60].map((alt) => html`<g key=${alt}><circle class="ax" cx=${C} cy=${C} r=${((90 - alt) / 90) * R} fill="none" /><text x=${C + 3} y=${C - ((90 - alt) / 90) * R - 3}>${alt}°</text></g>`)}<path class="ax" d=${`M${C - R} ${C}H${C + R}M${C} ${C - R}V${C + R}`} />
    ${slit !== null && html`<path class="slit" d=${arc(slit, 15, R + 4)} />`}
    ${targets.map((target) => { const at = altaz(target, now, site); if (at.alt < 0) return null; const [tx, ty] = place(at); return html`<g key=${target.name}><path class="ln s4" d=${`M${tx - 4} ${ty}h8M${tx} ${ty - 4}v8`} /><text x=${tx + 8} y=${ty + 4}>${target.name}</text></g>`; })}
    ${moonAt.alt > 0 && (() => { const [mx, my] = place(moonAt); return html`<circle class="lim" cx=${mx} cy=${my} r=${(30 / 90) * R} /><circle class="moon" cx=${mx} cy=${my} r="7" /><text x=${mx} y=${my + 20} text-anchor="middle">Moon</text>`; })()}
    ${here && html`<g class="aim"><circle cx=${x} cy=${y} r="8" /><path d=${`M${x - 14} ${y}h6M${x + 8} ${y}h6M${x} ${y - 14}v6M${x} ${y + 8}v6`} /></g>`}
    ${NAMES.map(([name, dx, dy]) => html`<text key=${name} x=${C + dx} y=${C + dy} text-anchor="middle" class=${name === "N" ? "h" : ""}>${name}</text>`)}</svg>
    <div class="read row between"><span>Alt <b>${here ? `${number(here.alt)}°` : "—"}</b>${hidden ? " below the horizon or the limit" : ""}</span><span>Az <b>${here ? `${number(here.az)}°` : "—"}</b></span><span>Moon <b>${away === null ? "—" : `${number(away, 0)}°`}</b> away, ${number(100 * luna.lit, 0)} %</span><span>LST <b>${String(Math.floor(sidereal)).padStart(2, "0")}:${String(Math.floor((sidereal % 1) * 60)).padStart(2, "0")}</b></span></div><p class="tagline">Bright arc: dome slit. Ring: 30° from the Moon.${walls ? " Hatched: below the horizon or the limit." : ""}</p></div>`;
}
