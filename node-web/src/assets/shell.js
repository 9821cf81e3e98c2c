// What surrounds every page: the rail of telescopes, the clock, the worst alert, the bar of a phone.
import { html, useEffect, useRef } from "./lib.js";
import { CloseButton, Closing } from "./close.js";
import { clock, day, duration, nightDay } from "./format.js";
import { inputWords } from "./inputs.js";
import { choose, theme } from "./look.js";
import { Age, Counts, Guard, Icon, Mode, Priority, PRIORITIES, SIGNS, Shape, Simulated, Words, isCalm, postureIcon, realTime, standing, summaryAge, totals, urgency } from "./parts.js";
import { route } from "./route.js";
import { nightsOf } from "./site.js";
import { fault, link, lostAt, net, roundTrip, skyNow, skySpeed, tick, version } from "./store.js";
import { leave, me } from "./user.js";

const NETWORK_PAGES = [["network", "/", "Network", "network"], ["alerts", "/alerts", "Alerts", "bell"], ["weather", "/weather", "Weather", "cloud"], ["frames", "/frames", "Frames", "image"],
  ["report", "/report", "Night report", "report"], ["log", "/log", "Log", "log"], ["nodes", "/nodes", "Nodes", "nodes"], ["audit", "/audit", "Audit", "hand"], ["settings", "/settings", "Settings", "lock"]];
const TELESCOPE_PAGES = [["now", "Now"], ["guiding", "Guiding"], ["focus", "Focus"], ["lightcurve", "Light curve"], ["schedule", "Schedule"], ["frames", "Frames"], ["weather", "Weather"], ["devices", "Devices"],
  ["report", "Report"], ["controls", "Controls"], ["log", "Log"], ["audit", "Audit"]];

/** Telescopes by site, shared equipment left out, both by name. */
export function bySite(summaries = [...net.value.values()]) {
  const sites = new Map();
  for (const summary of summaries.filter((one) => !one.shared).sort((a, b) => a.id.localeCompare(b.id))) {
    if (!sites.has(summary.site_id)) sites.set(summary.site_id, []);
    sites.get(summary.site_id).push(summary);
  }
  return sites;
}

/** One word on what a telescope does. */
export function doing(summary, now) {
  if (now.never) return "silent";
  if (!now.fresh) return now.worth;
  if (summary.activity?.length) return { object: "observing", cool_camera: "cooling", autofocus: "focus", calibration: "darks" }[summary.activity[0].action] ?? String(summary.activity[0].action).replaceAll("_", " ");
  const [reason] = summary.safety?.reasons ?? [];
  if (now.safety !== "safe") return reason ? `waits for ${inputWords(reason.input)}` : "unsafe";
  return summary.ended ? "night over" : "waiting";
}

function Rail() {
  const { page, id } = route.value;
  const all = [...net.value.values()];
  return html`<nav class="rail" aria-label="Main"><a class="brand" href="/"><${Icon} name="mesh" /><span class="lbl">Starmesh</span></a>
    ${NETWORK_PAGES.map(([name, href, word, icon]) => html`<a key=${name} class="nav" href=${href} aria-current=${!id && page === name ? "page" : null}><${Icon} name=${icon} /><span class="lbl">${word}</span>
      ${name === "alerts" && html`<span class="counts lbl"><${Counts} counts=${totals(all)} /></span>`}</a>`)}
    ${[...bySite(all)].map(([site, telescopes]) => html`<div class="group" key=${site}><b>${site}</b></div>${telescopes.map((summary) => {
      const now = standing(summary);
      const worst = urgency(summary, now);
      return html`<a key=${summary.id} class=${`nav tel ${summary.activity?.length && now.fresh ? "works" : ""}`} href=${`/t/${summary.id}`} aria-current=${id === summary.id ? "page" : null} data-testid="rail-telescope">
        <${Icon} name=${postureIcon(now.posture)} /><span class="nm cut">${summary.telescope_id}</span><span class="end"><span class="cut" title=${doing(summary, now)}>${doing(summary, now)}</span>${worst < 4 && html`<span class=${`ink-p${worst}`} title=${PRIORITIES[worst - 1]}><${Shape} n=${worst} /></span>`}</span></a>`;
    })}`)}
    <div class="foot"><div class="seg lbl" role="group" aria-label="Theme">${[["dark", "Dark"], ["night", "Night"], ["light", "Light"]].map(([value, word]) =>
      html`<button key=${value} type="button" data-set-theme=${value} aria-pressed=${String(theme.value === value)} onClick=${() => choose("theme", value)}>${word}</button>`)}</div>
      ${me.value && html`<div class="me"><a href="/settings" class="avatar" aria-label="Settings and users">${me.value.name.slice(0, 2).toUpperCase()}</a><span class="lbl">${me.value.name}${me.value.way === "session" && html` <button class="btn sm quiet" onClick=${leave}>Log out</button>`}</span></div>`}</div></nav>`;
}

function NextTheme() {
  const next = () => /** @type {HTMLElement} */ (document.querySelector(`[data-set-theme="${{ dark: "night", night: "light", light: "dark" }[document.documentElement.dataset.theme] ?? "night"}"]`))?.click();
  useEffect(() => {
    const press = (event) => {
      if (/input|textarea|select/i.test(event.target.tagName) || event.metaKey || event.ctrlKey || event.altKey) return;
      if (event.key === "t") next();
      if (event.key === "/") {
        const found = /** @type {HTMLElement} */ (document.querySelector("input[type=search]"));
        if (found) {
          event.preventDefault();
          found.focus();
        }
      }
    };
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  }, []);
  return html`<button class="btn sm quiet phone" onClick=${next} aria-label="Next theme"><${Icon} name="moon" /></button>`;
}

function Top({ title }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const sky = skyNow();
  const { id, site } = route.value;
  const nights = nightsOf([...net.value.values()].filter((one) => (id ? one.id === id : !one.shared)));
  const words = { live: `live${roundTrip.value === null ? "" : `, ${Math.round(roundTrip.value)} ms`}`, lost: "LINK LOST", connecting: "connecting" }[link.value];
  return html`<header class="top"><div class="crumbs grow">${id ? html`<a href="/">${site}</a> <b class="cut">${title}</b>` : html`<b class="cut">${title}</b>`}</div>
    <div class="clock"><b data-testid="utc">${sky === null ? "--:--:--" : clock(sky)}</b><span>UTC${link.value === "lost" ? " ?" : ""}${skySpeed() !== 1 && sky !== null ? ` × ${skySpeed()}` : ""}</span></div>
    ${nights.length > 0 && html`<div class="clock opt"><span data-testid="night-name">${nightName(nights)}</span></div>`}<span class="sep"></span>
    <span class="linkstate opt" data-link=${link.value} data-testid="link">${words}</span>
    <a class="counts" href="/alerts" aria-label="Alerts"><${Counts} counts=${totals([...net.value.values()])} /></a><${NextTheme} /></header>`;
}

/** `night of 20 Nov`, named by its evening. */
const nightName = (nights) => `night of ${nights.map((night) => nightDay(night).split(" ").slice(1).join(" ")).join(" / ")}`;

/** The worst that needs somebody, of all telescopes: what the bar says, and whose Close it has; null while it says that there is no link. */
export function worst() {
  let found = null;
  if (link.value === "lost") return found;
  for (const summary of net.value.values()) {
    const now = standing(summary);
    const alert = summary.alerts?.find((one) => !isCalm(one));
    const rank = urgency(summary, now);
    if (rank <= 2 && (!found || rank < found.rank)) found = { rank, summary, now, alert };
  }
  return found;
}

/** Why a telescope whose two words are alarming is so, in one sentence. */
export function alarm(summary, now) {
  if (!now.fresh) return [summary.now || `Nothing has come from its observatory node for ${duration(summaryAge(summary))}${realTime()}`, ...now.domes].join(". ");
  if (now.posture === "unknown") return "Whether its dome is closed is not known.";
  return `${now.safety.toUpperCase()} and ${String(now.posture).toUpperCase()}.`;
}

function Banner() {
  tick.value; // eslint-disable-line no-unused-expressions
  const open = me.value?.insecure_open && html`<div class="banner p2 open" role="alert"><${Priority} word="high" /><p class="grow"><b>This server is open to everybody.</b> <span class="m">Whoever reaches it may order everything. Make users: <code>starmesh user add</code>.</span></p></div>`;
  if (link.value === "lost") {
    return html`${open}<div class="banner lost" role="alert" data-testid="link-lost"><span class="pri off">No link</span><p class="grow"><b>No link to the server${lostAt.value ? ` since ${skyNow() - lostAt.value > 12 * 3600e3 ? `${day(lostAt.value)} ` : ""}${clock(lostAt.value)}` : ""}.</b>
      <span class="m"> What you see is old. Trying again … ${fault.value} A close order goes out only when the link is back.</span></p></div>`;
  }
  const found = worst();
  return html`${open}${found && html`<div class=${`banner ${found.rank === 2 ? "p2" : ""}`} role="alert" data-testid="banner"><${Priority} word=${PRIORITIES[found.rank - 1]} />
      <p class="grow call"><a href=${`/t/${found.summary.id}`}><b>${found.summary.telescope_id}: ${found.alert?.cause ?? alarm(found.summary, found.now)}</b></a> <span class="m desk">${found.alert?.consequence ?? ""}</span></p>
      <span class="end"><a class="btn sm soft" href="/alerts">What to do</a>${!found.summary.shared && route.value.id !== found.summary.id && html`<${CloseButton} id=${found.summary.id} sm named />`}</span></div>`}`;
}

/** The head of each page of a telescope: its two words, Close at a fixed place, its pages. */
export function TelescopeHead({ summary }) {
  const { page, id } = route.value;
  const now = standing(summary);
  const tabs = useRef(null);
  useEffect(() => {
    const current = tabs.current.querySelector("[aria-current]");
    if (current) tabs.current.scrollLeft = current.offsetLeft - tabs.current.offsetLeft - 40;
  }, [page]);
  return html`<header class="scope"><div class="scope-h"><h1 tabindex="-1">${summary.telescope_id}</h1>${!summary.shared && html`<${Simulated} summary=${summary} /><span class="break"></span><${Words} now=${now} lg /><${Mode} now=${now} />`}<span class="grow"></span>
      <${Age} s=${() => summaryAge(summary)} worth=${now.worth} after=" ago" />${!summary.shared && html`<${CloseButton} id=${id} named cls="desk" />`}</div>
    <nav class="tabs" ref=${tabs} aria-label=${summary.telescope_id}>${TELESCOPE_PAGES.map(([name, word]) => html`<a key=${name} href=${name === "now" ? `/t/${id}` : `/t/${id}/${name}`} aria-current=${page === name ? "page" : null}>${word}</a>`)}</nav></header>`;
}

function Bottom() {
  const { page, id } = route.value;
  const first = id ?? [...net.value.values()].find((summary) => !summary.shared)?.id;
  const of = (name) => (first ? `/t/${first}${name}` : "/");
  const links = [["/", "network", "Network", !id && page === "network"], [of(""), "scope", "Telescope", Boolean(id) && page === "now"], ["/alerts", "bell", "Alerts", page === "alerts"],
    [id ? of("/weather") : "/weather", "cloud", "Weather", page === "weather"], [of("/controls"), "ctrl", "Controls", page === "controls"]];
  return html`<nav class="bottom" aria-label="Main, phone">${links.map(([href, icon, word, current]) => html`<a key=${word} href=${href} aria-current=${current ? "page" : null}><${Icon} name=${icon} />${word}</a>`)}</nav>`;
}

function Foot() {
  tick.value; // eslint-disable-line no-unused-expressions
  const telescopes = [...net.value.values()].filter((summary) => !summary.shared);
  return html`<footer class="foot-line"><span>web ${version.value}</span><span>${telescopes.filter((summary) => standing(summary).fresh).length} of ${telescopes.length} telescopes live</span>${me.value && html`<span>web/${me.value.name}</span>`}<a href="/api/docs" target="_blank">API</a></footer>`;
}

/** The shell around a page. */
export function Shell({ title, children }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const { id, page } = route.value;
  const summary = id && net.value.get(id);
  useEffect(() => {
    document.body.dataset.drawn = String(performance.now());
    document.documentElement.dataset.link = link.value;
    document.body.dataset.link = link.value;
    const sums = totals([...net.value.values()]);
    const highest = PRIORITIES.slice(0, 3).find((word) => sums[word] > 0);
    document.title = `${link.value === "lost" ? "NO LINK – " : ""}${highest ? `${SIGNS[PRIORITIES.indexOf(highest)]}${sums[highest]} ` : ""}${title} – Starmesh`;
    // Each is a file of its own, since the security policy takes no picture that is made here.
    const [icon, href] = [document.querySelector('link[rel="icon"]'), `/assets/favicon${highest ? `-${highest}` : ""}.svg`];
    if (icon?.getAttribute("href") !== href) icon?.setAttribute("href", href);
  });
  return html`<${Guard} name="navigation"><${Rail} /><//>
    <div class="col"><${Guard} name="clock and link"><${Top} title=${title} /><//><${Guard} name="banner"><${Banner} /><//>
      <main id="main" tabindex="-1">${summary && html`<${Guard} name="safety and posture" key=${id}><${TelescopeHead} summary=${summary} /><//>`}<${Guard} name=${title} key=${location.pathname}>${children}<//></main>
      <nav class="more phone row wrap" aria-label="Other pages">${NETWORK_PAGES.filter(([name]) => !["network", "alerts", "weather"].includes(name)).map(([name, href, word, icon]) => html`<a key=${name} class="btn sm quiet" href=${href} aria-current=${!id && page === name ? "page" : null}><${Icon} name=${icon} /><span>${word}</span></a>`)}</nav></div>
    <${Foot} />
    ${summary && !summary.shared && html`<div class="dock row phone"><${CloseButton} id=${id} named xl /></div>`}
    <${Bottom} /><${Closing} />`;
}
