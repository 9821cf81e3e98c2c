// Log lines of one telescope or of all: live, or searched in the archive by text, level, node and time, also the lines around a moment.
import { html, useEffect, useMemo, useSignal } from "../lib.js";
import { ask } from "../api.js";
import { clock, day, hourMinute, shortDay } from "../format.js";
import { Card, Empty, Icon, Segment } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { net, skyNow, useTopic } from "../store.js";

const LEVELS = ["error", "warn", "info", "debug"];
const SHAPE = { error: "1", warn: "2" };
const AROUND_S = 120;
const HOURS = [[1, "1 h"], [6, "6 h"], [24, "24 h"], [72, "3 d"]];
const MOST = 1000;

/** Ids are long and alike: their end tells them apart. */
const shorter = (value) => (/^[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}$/.test(value) ? `…${String(value).slice(-8)}` : value);
const millis = (utc) => { const time = new Date(utc); return Number.isNaN(time.getTime()) ? "?" : time.toISOString().slice(11, 23); };
const fieldsOf = (line) => (typeof line.fields === "object" && line.fields ? Object.entries(line.fields).map(([name, value]) => `${name}=${shorter(value)}`).join(" ") : "");
const stamp = (ms) => new Date(Math.round(ms)).toISOString();

/** Are two times of the same UTC day? */
const isSameDay = (a, b) => Math.floor(a / 86400e3) === Math.floor(b / 86400e3);

/** A time that somebody wrote, in UTC; null where it is none. */
const timeOf = (text) => { const ms = Date.parse(`${text.trim().replace(" ", "T").replace(/Z$/, "")}Z`); return Number.isFinite(ms) ? stamp(ms) : null; };

/** Lines that repeat each other are one, with their number. */
function folded(lines) {
  const out = [];
  for (const line of lines) {
    const last = out[out.length - 1];
    if (last && last.message === line.message && last.node === line.node && last.telescope === line.telescope && last.level === line.level && fieldsOf(last) === fieldsOf(line) && isSameDay(Date.parse(last.at_utc), Date.parse(line.at_utc))) last.times += 1;
    else out.push({ ...line, times: 1 });
  }
  return out;
}

/** Those that fit all conditions. The archive looks for them by the same rules; here they are for what comes live, and until the archive's answer to what was typed last has come. */
const fitting = (lines, { level, text, node }) => lines.filter((line) => line.gap || (LEVELS.indexOf(line.level) <= LEVELS.indexOf(level) && (!node || line.node === node || String(line.node).startsWith(`${node}/`))
  && `${line.message} ${line.node} ${line.telescope ?? ""} ${fieldsOf(line)}`.toLowerCase().includes(text.toLowerCase())));

function Lines({ lines, here, telescope }) {
  if (!lines.length) return html`<${Empty} icon="log" title="No lines">None was written, or none fits the search.<//>`;
  const all = folded(lines);
  const dayOf = (line) => Math.floor(Date.parse(line.at_utc) / 86400e3);
  const today = Math.floor((skyNow() ?? 0) / 86400e3);
  const isDated = all.some((line) => dayOf(line) < today || dayOf(line) > today);
  let shown = null;
  /** What stands above the first line of a day, where not all are of today. */
  const heading = (line) => {
    const found = dayOf(line);
    if (!isDated || !Number.isFinite(found) || found === shown) return [];
    shown = found;
    return [html`<li key=${`day ${found}`} class="day" data-testid="day">${day(line.at_utc)}</li>`];
  };
  return html`<ul class="log" tabindex="0" aria-label="Log lines, newest first" data-testid="lines" data-count=${lines.length}>${all.flatMap((line) => [...heading(line), html`<li key=${`${line.at_utc} ${line.number ?? ""} ${line.telescope ?? ""} ${line.message}`} data-l=${line.level} class=${here && Math.abs(Date.parse(line.at_utc) - here) < 1000 ? "here" : ""}>
    <time datetime=${line.at_utc} title=${line.at_utc}>${millis(line.at_utc)}</time><span class="lv">${SHAPE[line.level] && html`<svg class="sh" aria-hidden="true"><use href=${`#sh${SHAPE[line.level]}`} /></svg> `}${String(line.level).toUpperCase()}</span>
    <span class="src cut">${line.telescope ?? ""}</span><span class="src cut">${line.node}</span><span class="msg cut" title=${`${line.message} ${fieldsOf(line)}`}>${line.message} <span class="f">${fieldsOf(line)}</span></span>
    <span>${line.times > 1 && html`<span class="fold">×${line.times}</span>`}<a class="quiet" href=${withQuery({ at: line.at_utc, telescope: telescope ? null : line.telescope ?? null })} aria-label=${`Lines around ${clock(line.at_utc)}`}><${Icon} name="clock" /></a></span></li>`])}</ul>`;
}

const BINS = 72;
const BIN_STEPS_S = [1, 5, 10, 30, 60, 300, 600, 1800, 3600, 7200];

/** How many lines of each level were written when; a touch leads to that moment. */
function Rate({ lines, from, to, telescope }) {
  const step = (BIN_STEPS_S.find((s) => (to - from) / 1000 / s <= BINS) ?? 14400) * 1000;
  const t0 = Math.floor(from / step) * step;
  const bins = Array.from({ length: Math.min(200, Math.max(1, Math.ceil((to - t0) / step))) }, () => ({ error: 0, warn: 0, info: 0 }));
  for (const line of lines) {
    const bin = bins[Math.floor((Date.parse(line.at_utc) - t0) / step)];
    if (bin) bin[line.level === "error" || line.level === "warn" ? line.level : "info"] += 1;
  }
  const most = Math.max(1, ...bins.map((bin) => bin.error + bin.warn + bin.info));
  const [W, H] = [1000, 84];
  const w = W / bins.length;
  const sum = (level) => bins.reduce((all, bin) => all + bin[level], 0);
  // A range that is not all of today has its days.
  const isToday = isSameDay(from, skyNow() ?? to) && isSameDay(from, to);
  const dated = (t, time = clock(t)) => (isToday ? time : `${shortDay(t)} ${time}`);
  const words = `${sum("error")} errors, ${sum("warn")} warnings, ${sum("info")} others, from ${dated(from)} to ${dated(to)}`;
  return html`<${Card} name=${`Lines each ${step >= 3600e3 ? `${step / 3600e3} h` : step >= 60e3 ? `${step / 60e3} min` : `${step / 1000} s`}`} end=${html`<span class="m">most ${most}</span><span class="ink-p2 nw">◆ ${sum("warn")} warn</span><span class="ink-p1 nw">▲ ${sum("error")} error</span>`}>
    <svg class="rate" viewBox=${`0 0 ${W} ${H}`} preserveAspectRatio="none" role="img" aria-label=${words}>${bins.map((bin, i) => {
      let y = H;
      const part = (level, cls) => { const h = (bin[level] / most) * H; y -= h; return h > 0 && html`<rect class=${cls} x=${(i * w + w * 0.15).toFixed(1)} y=${y.toFixed(1)} width=${(w * 0.7).toFixed(1)} height=${Math.max(1.5, h).toFixed(1)} />`; };
      return html`<g key=${i} onClick=${() => go(withQuery({ at: stamp(t0 + (i + 0.5) * step), telescope }))}><title>${`${dated(t0 + i * step)}: ${bin.error} errors, ${bin.warn} warnings, ${bin.info} others`}</title><rect class="none" x=${(i * w).toFixed(1)} y="0" width=${w.toFixed(1)} height=${H} />${part("error", "r-error")}${part("warn", "r-warn")}${part("info", "r-info")}</g>`;
    })}</svg><div class="ribbon-l"><span>${dated(from, hourMinute(from))}</span><span>UTC</span><span>${dated(to, hourMinute(to))}</span></div><//>`;
}

function Live({ id, filter }) {
  const lines = useTopic(`log${id ? `?telescope=${id}` : ""}`);
  if (!lines) return html`<p class="m">Reading the log …</p>`;
  const shown = fitting(lines, filter);
  return html`<${Card} name="Live" flush end=${`${shown.length} of the newest ${lines.length} lines`}><${Lines} lines=${shown.slice(0, 300)} telescope=${id} /><//>`;
}

/** Lines of some telescopes between two times, the newest first: `{ lines, truncated, problems, loading }`. */
function useLines(ids, from, to, { level, text, node }, again) {
  const state = useSignal({ lines: [], truncated: false, problems: [], loading: true });
  const name = JSON.stringify([ids, from, to, level, text, node, again]);
  useEffect(() => {
    const stop = new AbortController();
    const range = { from_utc: stamp(from), to_utc: stamp(to), limit: String(MOST) };
    // The archive has no line below `info`.
    const search = { ...(level !== "debug" && { level }), ...(text && { text: text.slice(0, 100) }), ...(node && { node }) };
    const one = (id) => ask(`/api/v1/telescopes/${id}/log?${new URLSearchParams({ ...range, ...search })}`, { signal: stop.signal });
    // What is typed is asked for when it pauses.
    const timer = setTimeout(async () => {
      state.value = { ...state.peek(), loading: true };
      const answers = await Promise.allSettled(ids.map(one));
      if (stop.signal.aborted) return;
      const lines = answers.flatMap((answer, i) => (answer.status === "fulfilled" ? (Array.isArray(answer.value?.rows) ? answer.value.rows : []).map((row) => row?.log).filter(Boolean).map((line) => ({ ...line, telescope: line.telescope ?? ids[i] })) : []));
      state.value = { lines: lines.sort((a, b) => (a.at_utc < b.at_utc ? 1 : -1)), truncated: answers.some((answer) => answer.status === "fulfilled" && answer.value?.truncated), loading: false,
        problems: answers.map((answer, i) => (answer.status === "rejected" ? `${ids[i]}: ${answer.reason.message}` : null)).filter(Boolean) };
    }, 250);
    return () => {
      clearTimeout(timer);
      stop.abort();
    };
  }, [name]);
  return state.value;
}

/** Lines of the archive between two times. */
function Found({ ids, from, to, filter, here, title, end, telescope, older }) {
  const found = useLines(ids, from, to, filter, null);
  const lines = fitting(found.lines, filter);
  const oldest = found.lines[found.lines.length - 1];
  return html`${lines.length > 0 && html`<${Rate} lines=${lines} from=${found.truncated && oldest ? Date.parse(oldest.at_utc) : from} to=${to} telescope=${telescope} />`}
    <${Card} name=${title} flush end=${html`<span class="m">${found.loading ? "searching …" : `${lines.length} lines`}</span>${end}`}>
      ${found.problems.map((problem) => html`<p class="note p3" key=${problem}><span class="grow"><b>Not all could be read.</b> ${problem}</span></p>`)}
      ${found.truncated && html`<p class="note p3"><span class="grow">There are more lines than are shown: these are the newest. Search for less, or go back in time.</span>${oldest && older && html`<a class="btn sm soft" href=${older(oldest.at_utc)}>Older lines</a>`}</p>`}
      ${found.loading && !lines.length ? html`<p class="m pad">Reading the log …</p>` : html`<${Lines} lines=${lines} here=${here} telescope=${telescope} />`}<//>`;
}

export function Log({ id }) {
  const { query } = route.value;
  const chosen = id ?? query.get("telescope");
  const filter = { level: LEVELS.includes(query.get("level")) ? query.get("level") : "info", text: query.get("text") ?? "", node: query.get("node") ?? "" };
  const at = query.get("at");
  const moment = at ? Date.parse(at) : NaN;
  const end = query.get("to");
  const hours = Number(query.get("hours")) || 6;
  const mode = Number.isFinite(moment) ? "around" : query.get("view") === "search" ? "search" : "live";
  const span = [600, 3600].includes(Number(query.get("around_s"))) ? Number(query.get("around_s")) : AROUND_S;
  const set = (changes) => go(withQuery(changes), { replace: true });
  const telescopes = [...net.value.values()];
  const ids = chosen ? [chosen] : telescopes.filter((one) => !one.shared).map((one) => one.id).sort();
  // The end of a search stays where it was begun, so that it is not asked anew each second.
  const now = useMemo(() => skyNow(), [mode, hours, end, chosen, filter.text, filter.level, filter.node, skyNow() === null]);
  const nodes = [...new Set(telescopes.filter((one) => !chosen || one.id === chosen).flatMap((one) => one.nodes ?? []).map((one) => `${one.role}/${one.id}`))];
  const seen = useTopic(`log${chosen ? `?telescope=${chosen}` : ""}`);
  const known = [...new Set([...nodes, ...(seen ?? []).map((line) => String(line.node)), ...(filter.node ? [filter.node] : [])])].sort();
  const to = end && Number.isFinite(Date.parse(end)) ? Date.parse(end) : now;
  return html`<div class="page-h">${id ? html`<h2>Log</h2>` : html`<h1 tabindex="-1">Log</h1>`}<span class="grow"></span><${Segment} label="Which lines" options=${[["live", "Live"], ["search", "Archive"]]} value=${mode === "around" ? "search" : mode} onChange=${(value) => set({ view: value === "live" ? null : value, at: null, to: null })} /></div>
    <div class="row wrap chips-x"><label class="in"><${Icon} name="search" /><input type="search" placeholder="Text, field or id" aria-label="Search the log" value=${filter.text} onInput=${(event) => set({ text: event.target.value })} /><kbd>/</kbd></label>
      <${Segment} label="Level" options=${[["debug", "All"], ["info", "Info and up"], ["warn", "Warn and up"], ["error", "Error"]]} value=${filter.level} onChange=${(value) => set({ level: value === "info" ? null : value })} />
      ${!id && html`<label class="in"><select aria-label="Telescope" onChange=${(event) => set({ telescope: event.target.value || null, node: null })}><option value="">All telescopes</option>${telescopes.map((one) => html`<option key=${one.id} value=${one.id} selected=${one.id === chosen}>${one.id}</option>`)}</select></label>`}
      <label class="in"><select aria-label="Node" onChange=${(event) => set({ node: event.target.value || null })}><option value="" selected=${!filter.node}>All nodes</option>${known.map((node) => html`<option key=${node} value=${node} selected=${node === filter.node}>${node}</option>`)}</select></label>
      ${mode === "search" && html`<${Segment} label="How far back" options=${HOURS} value=${hours} onChange=${(value) => set({ hours: String(value) })} /><label class="in">until <input type="text" class="when" placeholder="now" aria-label="Until, UTC, such as 2026-11-27 04:12" key=${end} defaultValue=${end ? stamp(to).slice(0, 19).replace("T", " ") : ""} onChange=${(event) => set({ to: timeOf(event.target.value) })} /><span class="u">UTC</span></label>`}
      <span class="grow"></span><span class="tagline desk">UTC, newest first</span></div>
    ${mode === "live" ? html`<${Live} key=${chosen ?? ""} id=${chosen} filter=${filter} />`
      : mode === "around" ? html`<${Found} key="around" ids=${ids} from=${moment - span * 1000} to=${moment + span * 1000} filter=${filter} here=${moment} telescope=${chosen} title=${`Around ${shortDay(moment)} ${clock(moment)}`}
        end=${html`<${Segment} label="How far" options=${[[AROUND_S, "± 2 min"], [600, "± 10 min"], [3600, "± 1 h"]]} value=${span} onChange=${(value) => set({ around_s: value === AROUND_S ? null : String(value) })} /><a class="btn sm soft" href=${withQuery({ at: null })}>Live</a>`} />`
      : !ids.length || !to ? html`<p class="m">Connecting …</p>` : html`<${Found} key="search" ids=${ids} from=${to - hours * 3600e3} to=${to + (end ? 0 : 1000)} filter=${filter} telescope=${chosen} title="Archive" older=${(utc) => withQuery({ to: utc })} />`}`;
}
