// Who moved what: the records of device, observatory and web nodes, as the archive has them. Each command is one line, with what became of it.
import { html, useSignal } from "../lib.js";
import { clock, day, number } from "../format.js";
import { useWindow } from "../history.js";
import { Card, Empty, Icon, Loaded, Segment, Table } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { net } from "../store.js";

const HOURS = [[1, "1 h"], [12, "12 h"], [24, "24 h"], [168, "7 d"]];
const MOST = 2000;
const PAGE = 60;
const BAD = new Set(["refused", "failed", "lost", "superseded"]);
const WHO = { all: () => true, people: ({ from }) => /^(web|cli|api)\//.test(from), guard: ({ from }) => from === "guard", bad: ({ outcome }) => BAD.has(outcome?.is) };

/** Records of one command in one: it was taken, and ended so. The newest first. */
export function commandsOf(records) {
  const out = [];
  const open = new Map();
  for (const record of records) {
    const key = record.id && `${record.node} ${record.id} ${record.verb} ${record.device}`;
    const begun = key && open.get(key);
    if (begun) Object.assign(begun, { outcome: record.outcome, ended_utc: record.at_utc, records: begun.records + 1 });
    else {
      const one = { ...record, ended_utc: null, records: 1 };
      out.push(one);
      if (key) open.set(key, one);
    }
  }
  return out.reverse();
}

const outcomeWords = (outcome) => [String(outcome?.is ?? "—"), outcome?.detail ?? (outcome?.missing ? `${outcome.missing} records are missing` : outcome?.granted_token != null ? `token ${outcome.granted_token}` : "")];

/** Parameters in short: what a person asks first, without braces. */
function parameters(text) {
  try {
    return Object.entries(JSON.parse(text)).map(([name, value]) => `${name.replaceAll("_", " ")} ${typeof value === "object" && value ? JSON.stringify(value) : value}`).join(", ");
  } catch {
    return text ?? "";
  }
}

/** All records as a file, as they came. */
function save(id, records) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob(records.map((record) => `${JSON.stringify(record)}\n`), { type: "application/jsonl" }));
  link.download = `audit-${id.replace("/", "-")}.jsonl`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const COLUMNS = [{ key: "t", name: "When", sort: (one) => one.at_utc }, { key: "f", name: "Who", sort: (one) => one.from }, { key: "w", name: "What", sort: (one) => one.verb }, { key: "o", name: "Outcome", sort: (one) => one.outcome?.is }, { key: "s", name: "Took", num: true, cls: "hidep" }, { key: "n", name: "Written by", cls: "hidep", sort: (one) => one.node }];

function Records({ id }) {
  const { query } = route.value;
  const hours = Number(query.get("hours")) || 12;
  const who = query.get("who") in WHO ? query.get("who") : "all";
  const text = query.get("text") ?? "";
  const most = useSignal(PAGE);
  const { found } = useWindow(hours, (from) => `/api/v1/telescopes/${id}/audit?from_utc=${from}&limit=${MOST}`, 30);
  const set = (changes) => go(withQuery(changes), { replace: true });
  const records = (Array.isArray(found.data?.rows) ? found.data.rows : []).map((row) => row?.audit).filter(Boolean);
  const shown = commandsOf(records).filter((one) => WHO[who](one) && `${one.from} ${one.device ?? ""} ${one.verb} ${one.parameters ?? ""} ${one.reason ?? ""} ${outcomeWords(one.outcome).join(" ")} ${one.id ?? ""}`.toLowerCase().includes(text.toLowerCase()));
  if (found.error?.status === 403) return html`<${Empty} icon="lock" title="You may not read the audit">${found.error.message}<//>`;
  return html`<div class="row wrap chips-x"><label class="in"><${Icon} name="search" /><input type="search" placeholder="Person, device, order or reason" aria-label="Search the audit" value=${text} onInput=${(event) => set({ text: event.target.value })} /><kbd>/</kbd></label>
      <${Segment} label="Whose" options=${[["all", "All"], ["people", "People"], ["guard", "Guards"], ["bad", "Not done"]]} value=${who} onChange=${(value) => set({ who: value === "all" ? null : value })} /><${Segment} label="How far back" options=${HOURS} value=${hours} onChange=${(value) => set({ hours: String(value) })} />
      <span class="grow"></span><button class="btn sm soft" disabled=${!records.length} onClick=${() => save(id, records)}><${Icon} name="down2" /><span>Save records</span></button></div>
    <${Card} name="Who moved what" flush end=${`${shown.length} of ${records.length} records, newest first`}><${Loaded} of=${found} what="The audit">${() => html`${shown.length ? html`<${Table} label="Who moved what" cls="cards audit" columns=${COLUMNS} rows=${shown.slice(0, most.value)} keyOf=${(one) => `${one.chain} ${one.number}`} rowProps=${(one) => ({ "data-testid": "audit-row", "data-outcome": one.outcome?.is })} cells=${(one) => {
        const [word, detail] = outcomeWords(one.outcome);
        const took = one.ended_utc ? (Date.parse(one.ended_utc) - Date.parse(one.at_utc)) / 1000 : null;
        return html`<td class="k nw"><a class="quiet" href=${`/t/${id}/log?at=${encodeURIComponent(one.at_utc)}`} title=${`${one.at_utc}: the log of that minute`}>${day(one.at_utc).slice(4)} <b>${clock(one.at_utc)}</b></a></td><td class="wrap"><b>${one.from}</b>${one.from_host ? html` <span class="mm">${one.from_host}</span>` : ""}</td>
          <td class="wrap full"><b>${String(one.verb).replaceAll("_", " ")}</b> ${one.device ?? ""}${one.reason ? html` <em>“${one.reason}”</em>` : ""}${one.parameters && one.parameters !== "{}" ? html`<div class="mm cut2" title=${one.parameters}>${parameters(one.parameters)}</div>` : ""}</td>
          <td class="wrap"><span class=${BAD.has(word) ? "ink-p3" : null}>${BAD.has(word) ? "▼ " : ""}${word}</span> <span class="m">${detail}</span></td><td class="num hidep">${took === null ? "—" : `${number(took, 1)} s`}</td><td class="hidep m">${one.node}</td>`;
      }} />${shown.length > most.value && html`<p class="pad"><button class="btn sm soft" onClick=${() => { most.value += 4 * PAGE; }}>Show more</button> <span class="m">${most.value} of ${shown.length} are shown</span></p>`}` : html`<${Empty} icon="check" title="No record">Nothing was ordered or moved in this time, or nothing fits the search.<//>`}`}<//><//>
    <p class="tagline">The nodes' own files are chained by hashes; <code>starmesh audit verify</code> proves them.</p>`;
}

export function Audit({ id }) {
  const { query } = route.value;
  const telescopes = [...net.value.values()].sort((a, b) => Number(a.shared) - Number(b.shared) || a.id.localeCompare(b.id));
  const chosen = id ?? query.get("telescope") ?? telescopes[0]?.id;
  return html`<div class="page-h">${id ? html`<h2>Audit</h2>` : html`<h1 tabindex="-1">Audit</h1><span class="grow"></span><label class="in"><select aria-label="Telescope" onChange=${(event) => go(withQuery({ telescope: event.target.value }), { replace: true })}>${telescopes.map((one) => html`<option key=${one.id} value=${one.id} selected=${one.id === chosen}>${one.id}</option>`)}</select></label>`}</div>
    ${chosen ? html`<${Records} key=${chosen} id=${chosen} />` : html`<p class="m">Connecting …</p>`}`;
}
