// Pieces that many pages show: icons, words, ages, values, cards. Their looks are those of starmesh.css.
import { Component, computed, html, signal, useEffect, useMemo, useRef } from "./lib.js";
import { clock, duration, hourMinute } from "./format.js";
import { elapsed } from "./elapsed.js";
import { link, quality, skyNow, skySpeed, tick } from "./store.js";

export const Icon = ({ name, cls = "" }) => html`<svg class=${`i ${cls}`} aria-hidden="true"><use href=${`#i-${name}`} /></svg>`;
export const Shape = ({ n }) => html`<svg class="sh" aria-hidden="true"><use href=${`#sh${n}`} /></svg>`;
/** The same shapes as letters, in the order of `PRIORITIES`, for where nothing is drawn. */
export const SIGNS = ["▲", "◆", "▼", "●"];

/** Priorities of alerts in their order, each with its number and its word. */
export const PRIORITIES = ["critical", "high", "medium", "advisory"];
export const priorityNumber = (word) => PRIORITIES.indexOf(word) + 1 || 4;
const title = (word) => word[0].toUpperCase() + word.slice(1);

/** A priority by shape, colour and word; `off` where nobody needs to act now. */
export const Priority = ({ word, off, text }) => html`<span class=${`pri ${off ? "off" : `p${priorityNumber(word)}`}`}><${Shape} n=${priorityNumber(word)} />${text ?? title(word)}</span>`;

/** Counts of active alerts, each with its shape. */
export function Counts({ counts, cls = "" }) {
  const shown = PRIORITIES.slice(0, 3).map((word, i) => [word, i + 1, counts?.[word] ?? 0]).filter(([, , n]) => n > 0);
  return shown.map(([word, n, count]) => html`<span key=${n} class=${`ink-p${n} ${cls}`} data-testid=${`count-${word}`}><${Shape} n=${n} />${count}<span class="vh"> ${word}</span></span>`);
}

/** Age of a summary, s; null before its first message. */
export const summaryAge = (summary) => (summary.age_s === null || summary.age_s === undefined ? null : summary.age_s + (elapsed() - summary.received) / 1000);

/** How a summary stands now: its quality is judged here too, because messages stop coming when the link is lost. */
function judge(summary) {
  const age = summaryAge(summary);
  const worth = quality(age, 1);
  const fresh = age !== null && worth === "fresh";
  // Its nodes were stopped in good order: that they are silent concerns nobody, unless something is open.
  const stopped = !fresh && summary.stopped && summary.stopped.closed !== false ? summary.stopped : null;
  // While the observatory node is silent the server goes by the domes' own device nodes.
  const isOfDomes = !fresh && link.value === "live" && summary.posture_by === "domes";
  // Alerts count in the one, and not in the other.
  const concernOf = (word) => (stopped ? null : fresh || isOfDomes ? word : link.value === "live" && age !== null && worth === "lost" ? word ?? "critical" : null);
  const concern = concernOf(summary.concern);
  const level = concernOf(summary.safety_concern);
  return {
    worth: age === null ? "lost" : worth,
    never: age === null,
    fresh,
    stopped,
    concern: concern ? priorityNumber(concern) : null,
    level: level ? priorityNumber(level) : null,
    domes: fresh || link.value !== "live" ? NONE : summary.domes ?? NONE,
    safety: fresh ? summary.safety?.state ?? "unknown" : "unknown",
    posture: fresh || isOfDomes ? summary.posture : stopped?.closed ? "closed" : "unknown",
    mode: fresh ? summary.mode : "unknown",
  };
}
const NONE = [];
const standings = new WeakMap();

/** As a summary stands: judged each second, and what shows it is drawn anew only when the judgement changes. */
export function standing(summary) {
  if (!standings.has(summary)) {
    let before = null;
    standings.set(summary, computed(() => {
      tick.value; // eslint-disable-line no-unused-expressions
      const now = judge(summary);
      if (!before || Object.keys(now).some((name) => now[name] !== before[name])) before = now;
      return before;
    }));
  }
  return standings.get(summary).value;
}

/** Is nobody being called for it: its cause went away, somebody has acknowledged it, or it is shelved? */
export const isCalm = (alert) => Boolean(alert?.returned_utc || alert?.acknowledged_by || alert?.shelved_until_utc);

/** What became of it, in words. */
export const fate = (alert) => [
  alert.returned_utc && `its cause went away at ${clock(alert.returned_utc)}, and nobody has acknowledged it`,
  alert.acknowledged_by && `acknowledged by ${alert.acknowledged_by}${alert.acknowledged_utc ? ` at ${clock(alert.acknowledged_utc)}` : ""}`,
  alert.shelved_until_utc && `shelved until ${clock(alert.shelved_until_utc)}: ${alert.shelved_reason ?? ""}`,
].filter(Boolean).join(", ");

/** How many alerts of each priority call for somebody. */
export function countsOf(summary) {
  const counts = Object.fromEntries(PRIORITIES.map((word) => [word, 0]));
  for (const alert of summary.alerts ?? []) if (!isCalm(alert) && alert?.priority in counts) counts[alert.priority] += 1;
  return counts;
}

/** The most urgent priority of a telescope as 1 to 4, or 9: its two words and the alerts that call for somebody. */
export function urgency(summary, now = standing(summary)) {
  const counts = countsOf(summary);
  return Math.min(now.concern ?? 9, PRIORITIES.findIndex((word) => counts[word] > 0) + 1 || 9);
}

/** Counts of a list of summaries: alerts that call for somebody, and telescopes whose two words are alarming without one. */
export function totals(summaries) {
  const sum = { critical: 0, high: 0, medium: 0, advisory: 0 };
  for (const summary of summaries) {
    const counts = countsOf(summary);
    for (const priority of PRIORITIES) sum[priority] += counts[priority];
    const { concern } = standing(summary);
    const word = PRIORITIES[concern - 1];
    if (word && !counts[word]) sum[word] += 1;
  }
  return sum;
}

const SAFETY = { safe: "safe", unsafe: "unsafe", unknown: "unknown" };
const POSTURE = { open: "open", closed: "closed", opening: "moving", closing: "moving" };
export const postureIcon = (posture) => POSTURE[posture] ?? "domeq";

/** The two words, each alone: safety, then the dome. */
export function wordCells(now, lg = false, short = true) {
  const level = now.level ? `p${now.level}` : now.safety === "unsafe" && now.posture === "closed" ? "quiet" : null;
  const safetyLevel = now.level && (now.safety !== "safe" || now.posture === "unknown") ? `p${now.level}` : now.safety === "unsafe" ? level ?? "quiet" : null;
  const postureLevel = now.level && now.posture !== "closed" ? `p${now.level}` : null;
  const cls = `word ${lg ? "lg" : ""}`;
  const unknown = (subject) => (short ? "UNKNOWN" : `${subject} UNKNOWN`);
  return [html`<span class=${cls} data-safety=${now.safety} data-level=${safetyLevel}><span class="vh">safety </span><${Icon} name=${SAFETY[now.safety] ?? "unknown"} />${now.safety === "unknown" ? unknown("SAFETY") : now.safety.toUpperCase()}</span>`,
    html`<span class=${cls} data-posture=${now.posture} data-level=${postureLevel}><span class="vh">dome </span><${Icon} name=${postureIcon(now.posture)} />${now.posture === "unknown" ? unknown("DOME") : String(now.posture).toUpperCase()}</span>`];
}

/** Safety and posture: two words that never merge. */
export function Words({ now, lg }) {
  if (now.stopped) return html`<span class="words" data-testid="words" data-safety="stopped" data-posture=${now.posture}><span class=${`word ${lg ? "lg" : ""}`} data-level="quiet"><${Icon} name=${postureIcon(now.posture)} />${now.stopped.text}</span></span>`;
  return html`<span class="words" data-testid="words" data-safety=${now.safety} data-posture=${now.posture}>${wordCells(now, lg, false)}</span>`;
}

export const Mode = ({ now }) => (now.mode === "unknown" ? null : html`<span class="mode">${String(now.mode).toUpperCase()}</span>`);
export const Simulated = ({ summary }) => (summary.simulated ? html`<span class="mode sim">SIMULATION</span>` : null);

/** Beside ages while the simulated sky runs faster than this clock: ages are seconds of this one, and all other times are the sky's. */
export const realTime = () => (skySpeed() === 1 ? "" : ", real time");

/** Devices that do not answer though the action under way needs them, each with how long. */
export const Missing = ({ of }) => of.map((device) => html`<span class="ink-p2 missing" key=${device.key} data-testid="missing" data-device=${`${device.kind}/${device.name}`}><${Shape} n=2 />${device.name} has not answered for ${duration(device.silent)}${realTime()}</span>`);

/** By when the step under way should have ended, counted down; beyond it, by how much it is late. Under a sky that runs faster than the machine the time is
    mostly the machine's, and means nothing to a person. */
export function Expected({ by }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const sky = skyNow();
  if (!by || !sky || skySpeed() > 1) return null;
  const left = (Date.parse(by) - sky) / 1000;
  return html`<span class=${`expected ${left < 0 ? "ink-p2" : "m"}`} data-testid="expected">${left < 0 ? html`should have ended ${duration(-left)} ago` : html`should end <span class="by">by ${clock(by)}, </span><span class="nw">in ${duration(left)}</span>`}</span>`;
}

/** An age that ticks, with the word for what it is worth: seconds, or what gives them where it is drawn without its surroundings. */
export function Age({ s, worth, never = "not received yet", after = "" }) {
  tick.value; // eslint-disable-line no-unused-expressions
  if (typeof s === "function") s = s();
  if (s === null || s === undefined) return html`<span class="age" data-quality="lost">${never}</span>`;
  if (worth === "fresh" && link.value !== "live") worth = "stale";
  const words = { fresh: "", ageing: "", stale: "stale ", lost: "lost " }[worth] ?? "";
  return html`<span class="age" data-quality=${worth} data-age-s=${Math.floor(s)}>${words}${duration(s)}${after}${after && realTime()}</span>`;
}

/** A word that no longer comes: what it was, since when it is not known, and its age; `state` as of `stateOf`. */
export const Was = ({ state, word }) => html`<span data-testid="was"><span class="ink-stale">was ${word}; not known since ${hourMinute(state.until)}</span> <${Age} s=${state.age} worth=${state.worth} after=" ago" /></span>`;

/** A value with its name and unit. `worth` is its quality; what is lost is a dash. */
export function Stat({ name, value, unit, worth = "fresh", sub, lg, level }) {
  const gone = value === null || value === undefined || value === "" || worth === "lost";
  if (worth === "fresh" && link.value !== "live") worth = "stale";
  return html`<dl class=${`stat ${lg ? "lg" : ""}`} data-quality=${gone ? "lost" : worth}><dt>${name}</dt><dd><b class=${level ? `ink-${level}` : null}>${gone ? "—" : value}</b>${unit ? ` ${unit}` : ""}</dd>${sub && html`<dd class="sub">${sub}</dd>`}</dl>`;
}

/** A value on a scale whose far side, beyond the limit, is hatched. `range` is the newest hour's least and greatest. */
export function Bullet({ value, from, to, limit, below, range, over }) {
  const at = (v) => `${Math.max(0, Math.min(100, ((v - from) / (to - from)) * 100)).toFixed(1)}%`;
  if (value === null || value === undefined) return html`<div class="bullet gone"><i></i></div>`;
  const style = { "--v": at(value) };
  if (limit !== null && limit !== undefined) Object.assign(style, below ? { "--from": "0%", "--to": at(limit) } : { "--from": at(limit), "--to": "100%" });
  return html`<div class=${`bullet ${over ? "over" : ""} ${below ? "low" : ""}`} style=${style}>${range && html`<s style=${{ "--a": at(range[0]), "--b": at(range[1]) }}></s>`}<i></i></div>`;
}

/** A card with a title; `flush` where a table or a list fills it. */
export function Card({ name, end, flush, cls = "", children, testid, label }) {
  return html`<section class=${`card ${flush ? "flush" : ""} ${cls}`} aria-label=${label ?? name} data-testid=${testid}>
    ${name && html`<header><h2>${name}</h2>${end && html`<span class="end">${end}</span>`}</header>`}
    <${Guard} name=${label ?? name ?? "this part"}>${children}<//>
  </section>`;
}

/** Nothing yet, none, or broken: never an empty panel without a reason. */
export const Empty = ({ icon = "info", title: head, children, hatch }) => html`<div class=${`empty ${hatch ? "hatch" : ""}`}><${Icon} name=${icon} /><b>${head}</b>${children && html`<span>${children}</span>`}</div>`;

/** Sky time of the answer that a GET still shows, ms; of now while it is fresh. */
export const answeredAt = (of) => (of.worth === "fresh" || of.at === null ? skyNow() : skyNow() - (elapsed() - of.at) * skySpeed());

/** In the head of a card: of when the answer of a GET is, unless it is the newest. Nothing before the first answer. */
export const Old = ({ of }) => of.data !== null && of.worth !== "fresh" && html`<span class="ink-stale" data-testid="old">of ${hourMinute(answeredAt(of))}${of.error ? ", could not be read again" : ""}</span>`;

/** What an answer of the archive leaves out, and why. */
export const Cut = ({ of }) => of?.truncated === true && Array.isArray(of.rows) && html`<p class="note p3" data-testid="cut"><span class="grow">${of.cut ? `Not all could be read: ${of.cut}` : `There are older ones: these are the newest ${of.rows.length}.`}</span></p>`;

/** What a GET gave: `children(data)` once there is something, else why there is nothing yet. */
export function Loaded({ of, what, children }) {
  if (of.data !== null) return html`${of.error && html`<p class="note p3"><span class="grow"><b>${what} could not be read again.</b> ${of.error.message} What you see is of ${hourMinute(answeredAt(of))}.</span></p>`}<${Cut} of=${of.data} />${children(of.data)}`;
  if (of.error) return html`<${Empty} icon="warn" title=${`${what} cannot be read`} hatch>${of.error.message} <button class="btn sm soft" onClick=${of.again}>Try again</button><//>`;
  return html`<p class="m">Reading ${what} …</p>`;
}

/** Draws anew only where one of its `parts` is another one than before: for long lists of which a letter, or a second, changes a line. What `draw` reads stands in `parts`, and is no signal. */
export class Kept extends Component {
  shouldComponentUpdate({ parts }) {
    return parts.length !== this.props.parts.length || parts.some((part, i) => part !== this.props.parts[i]);
  }

  render({ draw }) {
    return draw();
  }
}

const AGAIN_MS = 2500;

/** A part that cannot be drawn says so in its place, and tries again by itself; the others are not concerned. */
export class Guard extends Component {
  constructor(props) {
    super(props);
    this.state = { error: null };
    this.again = 0;
    this.told = "";
  }

  static getDerivedStateFromError(error) {
    return { error };
  }

  componentDidCatch(error) {
    clearTimeout(this.again);
    this.again = setTimeout(() => this.setState({ error: null }), AGAIN_MS);
    if (this.told !== String(error)) console.warn(`${this.props.name} cannot be drawn`, error);
    this.told = String(error);
  }

  componentWillUnmount() {
    clearTimeout(this.again);
  }

  render({ name, children }, { error }) {
    if (!error) return children;
    return html`<div class="empty hatch" data-broken=${name}><${Icon} name="warn" /><b>${name}: this part cannot be shown</b>
      <span>${String(error?.message ?? error).slice(0, 200)}. It is tried again by itself.</span></div>`;
  }
}

/** A dialog that is open while it is shown; Escape and the area around it close it. */
export function Dialog({ label, close, children, cls = "" }) {
  const element = useRef(null);
  // A text that is marked beyond the edge of the dialog does not close it.
  const pressed = useRef(null);
  useEffect(() => {
    const dialog = element.current;
    const before = /** @type {HTMLElement} */ (document.activeElement);
    // Its first paragraph says what follows from it, and is read out with its name.
    const what = dialog.querySelector("p");
    if (what) {
      what.id = "consequence";
      dialog.setAttribute("aria-describedby", what.id);
    }
    dialog.showModal();
    (dialog.querySelector("[data-first]") ?? dialog).focus();
    return () => {
      dialog.close();
      before?.focus?.();
    };
  }, []);
  return html`<dialog ref=${element} class=${cls} aria-label=${label} onCancel=${(event) => { event.preventDefault(); close(); }}
    onPointerDown=${(event) => { pressed.current = event.target; }} onClick=${(event) => event.target === element.current && pressed.current === element.current && close()}><div class="stack">${children}</div></dialog>`;
}

/** A group of buttons of which one is pressed: `options` are `[value, word]`. */
export const Segment = ({ label, options, value, onChange, cls = "" }) => html`<span class=${`seg ${cls}`} role="group" aria-label=${label}>${options.map(([option, word]) =>
  html`<button key=${option} type="button" aria-pressed=${String(option === value)} onClick=${() => onChange(option)}>${word}</button>`)}</span>`;

/** The order that somebody gave a table, by its page and its name: whoever comes back finds it again. */
const orders = new Map();
function orderOf(name, first) {
  if (!orders.has(name)) orders.set(name, signal(first ?? { key: null, up: true }));
  return orders.get(name);
}

/** A table that may scroll sideways. `columns`: `{ key, name, num, sort(row), falls, cls }`, of which one that `falls` has the greatest first; `cells(row)` gives the `<td>`s. */
export function Table({ label, columns, rows, cells, keyOf, rowProps = noProps, cls = "", sorted = null }) {
  const order = useMemo(() => orderOf(`${location.pathname} ${label}`, sorted), [label]);
  const by = columns.find((column) => column.key === order.value.key);
  const shown = by?.sort ? [...rows].sort((a, b) => compare(by.sort(a), by.sort(b), order.value.up ? 1 : -1)) : rows;
  const press = ({ key, falls }) => () => { order.value = { key, up: order.value.key === key ? !order.value.up : !falls }; };
  return html`<div class="tw" tabindex="0" role="group" aria-label=${`${label}, may scroll sideways`}><table class=${cls}>
    <thead><tr>${columns.map((column) => html`<th key=${column.key} scope="col" class=${`${column.num ? "num" : ""} ${column.cls ?? ""}`} data-sort=${column.sort ? "" : null}
      aria-sort=${by === column ? (order.value.up ? "ascending" : "descending") : null}>${column.sort ? html`<button type="button" onClick=${press(column)}>${column.name}</button>` : column.name}</th>`)}</tr></thead>
    <tbody>${shown.map((row) => html`<${Row} key=${keyOf(row)} row=${row} rowProps=${rowProps} cells=${cells} />`)}</tbody></table></div>`;
}

/** With `cells` that stay the same function it is drawn anew only for its own changes. */
const Row = ({ row, rowProps, cells }) => html`<tr ...${rowProps(row)}>${cells(row)}</tr>`;
const noProps = (_) => ({});

/** What has no value comes last, whichever `way` the others go. */
function compare(a, b, way) {
  if (a === b) return 0;
  if (a === null || a === undefined) return 1;
  if (b === null || b === undefined) return -1;
  return a < b ? -way : way;
}

/** A time of day with its full stamp as title. */
export const Time = ({ utc }) => (utc ? html`<time datetime=${utc} title=${utc}>${clock(utc)}</time>` : "—");
