// All telescopes, the ones that need somebody first; and one sentence on all of them.
import { html } from "../lib.js";
import { activity } from "../activity.js";
import { CloseButton } from "../close.js";
import { clock, duration, number } from "../format.js";
import { arrived, Picture } from "../image.js";
import { Age, Bullet, Card, Empty, Expected, Guard, Icon, Missing, Mode, Priority, PRIORITIES, Segment, Simulated, Stat, Table, Words, isCalm, postureIcon, wordCells, standing, realTime, summaryAge, urgency } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { bySite, doing, worst } from "../shell.js";
import { link, moment, net, skyNow, skySpeed, tick, told, useTopic } from "../store.js";
import { devicesOf, known, useMissing } from "../devices.js";
import { Keys, Nights } from "../night.js";
import { inputWords, limitsOf } from "../inputs.js";

/** Does it need somebody, and how urgently? */
const needs = (summary) => urgency(summary) <= 3;
const isOpen = (summary) => ["open", "opening", "closing"].includes(standing(summary).posture);
const rank = (summary) => { const now = standing(summary); return urgency(summary, now) * 10 + (now.fresh ? (summary.activity?.length ? 1 : 2) : 0); };

/** The network in a few words: who needs somebody now, who later tonight, what can wait till tomorrow, and what the others do. */
function Lede({ telescopes }) {
  const who = (list, verb) => `${list.map((one) => one.telescope_id).join(", ")} ${list.length > 1 ? verb : { need: "needs", have: "has" }[verb]}`;
  const [now, later, tomorrow] = [(level) => level <= 2, (level) => level === 3, (level) => level === 4].map((is) => telescopes.filter((one) => is(urgency(one))));
  const rest = telescopes.filter((one) => urgency(one) > 3);
  const counts = new Map();
  for (const one of rest) { const does = doing(one, standing(one)); counts.set(does, (counts.get(does) ?? 0) + 1); }
  if (link.value === "lost") return html`<p class="lede grow" data-testid="lede"><b>Who needs you is not known: there is no link.</b> What follows is how it was.</p>`;
  return html`<p class="lede grow" data-testid="lede"><b>${now.length ? `${who(now, "need")} you now.` : `Nothing needs you${later.length ? " now" : ""}.`}</b> ${later.length > 0 && `${who(later, "need")} you later tonight. `}${tomorrow.length > 0 && `${who(tomorrow, "have")} something that can wait till tomorrow. `}
    ${[...counts].map(([does, n]) => `${n} ${n > 1 ? does.replace(/^waits/, "wait") : does}`).join(", ")}${counts.size ? "." : ""}</p>`;
}

/** One telescope; `brief` where its view has one line for it unless it needs somebody, `called` where the bar at the top has its Close. */
function Tile({ summary, brief, called }) {
  const now = standing(summary);
  const missing = useMissing(summary, now);
  const [what, sub] = activity(summary, now);
  const level = urgency(summary, now);
  const isLine = brief && level > 3;
  const image = !isLine && !(/** @type {any} */ (navigator).connection?.saveData) && arrived(summary);
  const top = summary.alerts?.find((one) => !isCalm(one));
  const figures = summary.figures ?? {};
  const worth = now.fresh ? "fresh" : now.worth;
  return html`<article class=${`tile ${now.fresh && !summary.activity?.length && level > 3 ? "rest" : ""}`} data-level=${level <= 3 ? `p${level}` : null} data-testid="tile" data-telescope=${summary.id} data-safety=${now.safety}
    data-posture=${now.posture} data-mode=${now.mode} data-quality=${now.worth}>
    <a class="cover" href=${`/t/${summary.id}`} aria-label=${`${summary.telescope_id}: ${what}`}></a>
    <div class="tile-h"><${Icon} name=${postureIcon(now.posture)} /><b>${summary.telescope_id}</b><span class="site cut">${summary.site_id}</span><span class="end"><${Simulated} summary=${summary} />${level <= 3 && html`<${Priority} word=${PRIORITIES[level - 1]} />`}</span></div>
    <div class="row between wrap"><${Words} now=${now} /><${Mode} now=${now} /></div>
    <div class=${`do ${image ? "" : "plain"}`}><div class="what">${what}</div><div class="sub">${top && level <= 3 && !missing.some((device) => device.alert === top.id) ? top.cause : sub} <${Missing} of=${missing} />${now.fresh && !isLine && html`<${Expected} by=${summary.activity?.[0]?.expected_by_utc} />`}</div>${image && html`<span class="thumb"><${Picture} image=${image} /></span>`}</div>
    <div class="stats"><${Stat} name="Guide" value=${figures.guide_rms_arcsec != null ? number(figures.guide_rms_arcsec, 2) : null} unit="″" worth=${worth} /><${Stat} name="FWHM" value=${figures.fwhm_arcsec != null ? number(figures.fwhm_arcsec, 2) : null} unit="″" worth=${worth} />
      <${Stat} name="Rows" value=${summary.schedule ? `${summary.schedule.finished}/${summary.schedule.rows}` : null} worth=${worth} /><${Stat} name="Frames" value=${summary.frames} worth=${worth} /></div>
    ${summary.unreadable?.length > 0 && html`<p class="ink-p2" data-unreadable=${summary.unreadable.length}>◆ ${summary.unreadable.length} ${summary.unreadable.length > 1 ? "payloads" : "payload"} cannot be read: ${summary.unreadable[0].key}</p>`}
    <div class="tile-f"><${Age} s=${() => summaryAge(summary)} worth=${now.worth} after=" ago" />${summary.device_count?.lost > 0 && html`<span class="ink-p3">${summary.device_count.known - summary.device_count.lost} of ${summary.device_count.known} devices answer</span>`}
      <${CloseButton} id=${summary.id} filled=${level === 1} sm cls=${called ? "desk" : ""} /></div></article>`;
}

/**
 * Name, field, unit, scale, decimals, property of the limit.
 * @type {[string, string, string, number, number, number, string][]}
 */
const WEATHER = [["Wind", "wind_mps", "m/s", 0, 25, 1, "WindSpeed"], ["Humidity", "humidity_percent", "%", 0, 100, 0, "Humidity"], ["Sky − air", null, "°C", -50, 5, 0, "RelativeSkyTemp"], ["Rain", "rain_mm_per_h", "mm/h", 0, 5, 1, "RainRate"]];

/** A socket has 256 topics at most; so many are for stations beyond the first of each site, the safety of the sites and the lines of the night. */
const TOPICS = 200;
const RANK = { fresh: 0, stale: 1, lost: 2 };
/** The freshest first; those that are fresh keep their order, so that values do not jump from one to another. */
const freshestFirst = (a, b) => RANK[a.worth] - RANK[b.worth] || (a.worth === "fresh" ? 0 : a.silent - b.silent);

/**
 * The weather stations of a site, those of its equipment that is shared and of its telescopes: the next owner is asked only while no station is fresh, `more` of them at most. `before` are those of the telescopes that were asked.
 */
function Site({ site, telescopes, ids = ownersOf(site, telescopes), more, before = NONE }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const [id, ...rest] = ids;
  const states = useTopic(`tel/${id}/device/observingconditions`);
  const stations = [...before, ...devicesOf(states).filter((one) => !before.some(({ key }) => key === one.key))].sort(freshestFirst);
  if (states && rest.length && more > 0 && link.value === "live" && stations[0]?.worth !== "fresh") return html`<${Site} site=${site} telescopes=${telescopes} ids=${rest} more=${more - 1} before=${stations} />`;
  return html`<${SiteNow} site=${site} telescopes=${telescopes} stations=${stations} none=${!states ? "Asking for its weather …" : rest.length ? `${id} has no weather station; its other telescopes may have one.` : "No weather station of this site is on the bus."} />`;
}
const NONE = [];
const ownersOf = (site, telescopes) => [`${site}/shared`, ...telescopes.map((one) => one.id).sort()].filter((id) => net.value.has(id));

/** A site: its weather now, and when it can be safe. */
function SiteNow({ site, telescopes, stations, none }) {
  const [station] = stations;
  const silent = stations.filter((one) => one.worth !== "fresh").length;
  const all = telescopes.map((one) => [one, standing(one)]);
  const worst = all.find(([, now]) => now.safety === "unknown") ?? all.find(([, now]) => now.safety === "unsafe") ?? all[0];
  const [summary, now] = worst;
  const icon = { safe: "safe", unsafe: "unsafe" }[now.safety] ?? "unknown";
  const fields = station?.fields ?? {};
  const value = (name) => (name ? fields[name] : known(fields.sky_c) && known(fields.air_c) ? fields.sky_c - fields.air_c : null);
  const verdict = useTopic(`tel/${summary.id}/observatory/safety`)?.get(`${summary.id}/observatory/safety/state`)?.body;
  const limitOf = (property) => limitsOf(verdict?.inputs, station?.name, property).find((one) => one.side === "above");
  const wait = summary.safety?.time_to_safe_s;
  return html`<section class="card site-c" aria-label=${site} data-testid="site"><div class="row between"><b class="nw">${site}</b><span class="word" data-level=${now.safety === "unknown" && now.level ? "p1" : now.safety === "safe" ? null : "quiet"}><${Icon} name=${icon} />${now.safety.toUpperCase()}</span></div>
    ${station ? html`<dl class="vals">${WEATHER.filter(([, name]) => name === null || known(fields[name])).slice(0, 3).map(([label, name, unit, from, to, digits, property]) => {
      const v = station.worth === "lost" ? null : value(name);
      const limit = limitOf(property);
      return html`<dt>${label}</dt><dd><${Bullet} value=${v} from=${from} to=${to} limit=${limit?.v} over=${limit && v !== null && v > limit.v} /></dd><dd class="v">${v === null || v === undefined ? "—" : html`<b>${number(v, digits)}</b>`} ${limit && html`<span class="desk">of ${number(limit.v, digits)}</span>`} ${unit}</dd>`;
    })}</dl>` : html`<p class="tagline">${none}</p>`}
    ${stations.length > 1 && html`<div class="tagline" data-testid="stations">By ${station.telescope}/${station.name}${silent ? html`; <span class="ink-stale">${silent} of ${stations.length} silent</span>` : `, one of ${stations.length}`}</div>`}
    <div class="tagline">${station && station.worth !== "fresh" ? html`<span class="ink-stale">Station silent for ${duration(station.silent)}${realTime()}</span>` : wait && now.safety === "unsafe" && skyNow() !== null
      ? html`Safe at the earliest ${clock(skyNow() + wait * 1000)} UTC, <b class="nw">in ${duration(wait)}</b>` : now.safety === "unsafe" ? (summary.safety?.reasons ?? []).slice(0, 1).map((reason) => `Waits for ${inputWords(reason.input)}: ${reason.why}`) : `${telescopes.length} ${telescopes.length > 1 ? "telescopes" : "telescope"}${skySpeed() !== 1 ? ", simulated" : ""}`}</div></section>`;
}

const columns = () => [{ key: "name", name: "Telescope", sort: (one) => one.telescope_id }, { key: "site", name: "Site", cls: "hidep", sort: (one) => one.site_id }, { key: "safety", name: "Safety", sort: (one) => rank(one) }, { key: "dome", name: "Dome", sort: (one) => standing(one).posture },
  { key: "does", name: "Does", sort: (one) => doing(one, standing(one)) }, { key: "target", name: "Target", cls: "hidep", sort: (one) => one.activity?.[0]?.object }, { key: "guide", name: "Guide ″", num: true, cls: "hidep", sort: (one) => one.figures?.guide_rms_arcsec }, { key: "fwhm", name: "FWHM ″", num: true, cls: "hidep", sort: (one) => one.figures?.fwhm_arcsec },
  { key: "frames", name: "Frames", num: true, cls: "hidep", sort: (one) => one.frames }, { key: "rows", name: "Rows", num: true, cls: "hidep", sort: (one) => one.schedule?.finished }, { key: "age", name: `Age${realTime()}`, num: true, sort: summaryAge }, { key: "alert", name: "Alert", sort: (one) => urgency(one) }];

/** What calls for somebody; else what somebody has seen already. */
function Called({ summary, level }) {
  if (level <= 4) return html`<${Priority} word=${PRIORITIES[level - 1]} />`;
  const calm = summary.alerts?.find(isCalm);
  return calm ? html`<${Priority} word=${calm.priority} off text=${calm.shelved_until_utc ? "shelved" : calm.acknowledged_by ? "acknowledged" : "returned"} />` : null;
}

const BY_SAFETY = { key: "safety", up: true };
const rowProps = (one) => ({ "data-quality": standing(one).worth, "data-testid": "row", "data-of": one.id });
const cells = (one) => {
  const now = standing(one);
  const level = urgency(one, now);
  const figure = (value) => (now.fresh && value != null ? number(value, 2) : "—");
  const [first] = one.activity ?? [];
  const [safety, dome] = wordCells(now);
  return html`<td class="k"><a href=${`/t/${one.id}`}><${Icon} name=${postureIcon(now.posture)} />${one.telescope_id}</a></td><td class="hidep">${one.site_id}</td><td>${safety}</td><td>${dome}</td><td>${doing(one, now)}</td><td class="hidep cut" title=${first?.object}>${first?.object ? html`<b>${first.object}</b>` : "—"}</td>
    <td class="num hidep"><b>${figure(one.figures?.guide_rms_arcsec)}</b></td><td class="num hidep"><b>${figure(one.figures?.fwhm_arcsec)}</b></td><td class="num hidep">${one.frames}</td><td class="num hidep">${one.schedule ? `${one.schedule.finished}/${one.schedule.rows}` : "—"}</td><td class="num"><${Age} s=${() => summaryAge(one)} worth=${now.worth} never="never" /></td><td><${Called} summary=${one} level=${level} /></td>`;
};

/** Changes what is chosen; the address keeps it. */
const set = (changes) => go(withQuery(changes), { replace: true });

/** A telescope a line, for tens of them: sorted and filtered, worst first. */
function All({ telescopes }) {
  const text = route.value.query.get("filter") ?? "";
  const shown = telescopes.filter((one) => `${one.id} ${activity(one, standing(one)).join(" ")}`.toLowerCase().includes(text.toLowerCase()));
  return html`<${Card} name="All telescopes" flush end=${html`${text && html`<span class="m">${shown.length} of ${telescopes.length}</span>`}<label class="in"><${Icon} name="search" /><input type="search" placeholder="Filter" aria-label="Filter telescopes" value=${text} onInput=${(event) => set({ filter: event.target.value })} /><kbd>/</kbd></label>`}>
    <${Table} label="All telescopes" cls="net cards" columns=${columns()} rows=${shown} sorted=${BY_SAFETY} keyOf=${(one) => one.id} rowProps=${rowProps} cells=${cells} /><//>`;
}

function NightOfAll({ telescopes }) {
  const now = moment.value;
  return now !== null && html`<${Card} name="The night, all telescopes" testid="nights" end=${html`<${Keys} ahead="planned" /><span class="desk">twilight of each site</span>`}><${Nights} telescopes=${telescopes} now=${now} /><//>`;
}

export function Network() {
  const { query } = route.value;
  const telescopes = [...net.value.values()].filter((one) => !one.shared).sort((a, b) => rank(a) - rank(b) || a.id.localeCompare(b.id));
  if (!telescopes.length) return html`<h1 class="vh" tabindex="-1">Network</h1>${told.value ? html`<${Empty} icon="scope" title="No telescope on the bus yet">Telescopes appear here by themselves when their nodes start.<//>` : html`<p class="m">Connecting …</p>`}`;
  const kinds = { all: () => true, need: needs, open: isOpen, wait: (one) => !one.activity?.length && !needs(one) };
  const called = worst()?.summary.id;
  const sites = bySite(telescopes);
  const more = Math.max(0, Math.floor((TOPICS - telescopes.length - 3 * sites.size) / sites.size));
  const show = query.get("show") in kinds ? query.get("show") : "all";
  const usual = telescopes.length > 16 ? "compact" : "cards";
  const chosen = ["cards", "compact"].includes(query.get("view")) ? query.get("view") : usual;
  return html`<div class="page-h"><h1 class="vh" tabindex="-1">Network</h1><${Lede} telescopes=${telescopes} /></div>
    <div class="sites" tabindex="0" role="group" aria-label="Sites">${[...sites].map(([site, here]) => html`<${Guard} name=${site} key=${site}><${Site} site=${site} telescopes=${here} more=${more + 1} /><//>`)}</div>
    <div class="row wrap chips-x">${[["all", "All"], ["need", "Need you"], ["open", "Open"], ["wait", "Waiting"]].map(([kind, word]) => html`<button key=${kind} class="chip" aria-pressed=${String(show === kind)} onClick=${() => set({ show: kind === "all" ? null : kind })}>${word} <i>${telescopes.filter(kinds[kind]).length}</i></button>`)}
      <span class="grow"></span><span class="tagline desk">Worst first</span><${Segment} label="View" options=${[["cards", "Cards"], ["compact", "Compact"]]} value=${chosen} onChange=${(value) => set({ view: value })} /></div>
    <div class="tiles" data-view=${chosen === "compact" ? "compact" : null}>${telescopes.filter(kinds[show]).map((one) => html`<${Guard} name=${one.telescope_id} key=${one.id}><${Tile} summary=${one} brief=${chosen === "compact"} called=${one.id === called} /><//>`)}</div>
    <${NightOfAll} telescopes=${telescopes} />
    <${All} telescopes=${telescopes} />`;
}
