// The report of a night: every second has a cause; targets, quality, alerts and orders.
import { html } from "../lib.js";
import { useReport } from "../api.js";
import { inputWords } from "../inputs.js";
import { bytes, clock, duration, nightDay, nightOf, number, plain } from "../format.js";
import { Card, Empty, Icon, Loaded, Old, Stat, Table } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { nightsOf, tonight } from "../site.js";
import { net } from "../store.js";

const CLASS = { open_shutter: ["c-ex", "Shutter open"], overhead: ["c-ov", "Overheads"], idle: ["c-wa", "Waiting"], daytime: ["c-ro", "Daytime"], weather: ["c-we", "Weather"], fault: ["c-fa", "Fault"], unexplained: ["c-un", "Not accounted"] };
const day = 86400e3;
const dateOf = (night) => Date.parse(`${night.slice(0, 4)}-${night.slice(4, 6)}-${night.slice(6, 8)}T12:00:00Z`);

/** The shares of a night as one bar. */
export const Account = ({ times }) => html`<div class="acct" role="img" aria-label=${times.map((one) => `${CLASS[one.group]?.[1] ?? one.group} ${number(100 * one.share, 1)} %`).join(", ")}>${times.filter((one) => one.time_s > 0).map((one) => html`<i key=${one.group} class=${CLASS[one.group]?.[0] ?? "c-un"} style=${{ flex: String(Math.max(1, Math.round(one.time_s))) }} title=${`${CLASS[one.group]?.[1] ?? one.group}: ${duration(one.time_s)}`}></i>`)}</div>`;

/** What happened, in order of time. */
function Timeline({ report }) {
  const [from, to] = [Date.parse(report.from_utc), Date.parse(report.to_utc)];
  const x = (utc) => (((Date.parse(utc) - from) / (to - from)) * 1000).toFixed(2);
  return html`<svg class="band" viewBox="0 0 1000 34" preserveAspectRatio="none" role="img" aria-label="The night in order of time; the table says the same">${report.timeline.map((one, i) => html`<rect key=${i} class=${CLASS[one.group]?.[0] ?? "c-un"} x=${x(one.from_utc)} y="0" width=${Math.max(0.4, Number(x(one.to_utc)) - Number(x(one.from_utc)))} height="34"><title>${`${clock(one.from_utc)} to ${clock(one.to_utc)}: ${inputWords(one.kind)}`}</title></rect>`)}</svg><div class="ribbon-l"><span>${clock(report.from_utc)}</span><span>${clock(report.to_utc)}</span></div>`;
}

function Whole({ id, report }) {
  const of = (group) => report.times.find((one) => one.group === group);
  const share = (group) => number(100 * (of(group)?.share ?? 0), 1);
  return html`<${Card} label="The night in figures"><div class="grid g4"><${Stat} lg name="Time" value=${duration(report.span_s)} sub=${`${clock(report.from_utc)} to ${clock(report.to_utc)} UTC${report.is_running ? ", so far" : ""}`} /><${Stat} lg name="Shutter open" value=${share("open_shutter")} unit="%" sub=${duration(of("open_shutter")?.time_s)} /><${Stat} lg name="Lost to weather" value=${share("weather")} unit="%" sub=${(of("weather")?.kinds ?? []).map((kind) => inputWords(kind.kind)).join(", ")} />
      <${Stat} lg name="Not accounted" value=${number(100 * report.unexplained_share, 2)} unit="%" sub="goal: below 1 %" /></div>${report.nothing_tried && html`<p class="note">${plain(report.nothing_tried)}</p>`}<//>
    <${Card} name="Where the night went" end=${Object.values(CLASS).map(([cls, word]) => html`<span class="nw row" key=${cls}><span class=${`sw ${cls}`}></span>${word}</span>`)}><${Account} times=${report.times} /><${Timeline} report=${report} />
      <${Table} label="Where the night went" columns=${[{ key: "g", name: "Class" }, { key: "k", name: "Cause" }, { key: "t", name: "Time", num: true, sort: (row) => row.time_s }]} rows=${report.times.flatMap((one) => one.kinds.map((kind) => ({ ...kind, group: one.group })))} keyOf=${(row) => `${row.group} ${row.kind}`} cells=${(row) => html`<td>${CLASS[row.group]?.[1] ?? row.group}</td><td class="k" title=${row.kind}>${inputWords(row.kind)}</td><td class="num">${duration(row.time_s)}</td>`} /><//>
    <${Card} name="Targets" flush><${Table} label="Targets" columns=${[{ key: "o", name: "Target" }, { key: "f", name: "Filter" }, { key: "n", name: "Frames", num: true }, { key: "e", name: "Exposed", num: true }, { key: "w", name: "FWHM ″", num: true }, { key: "l", name: "Ellipticity", num: true, cls: "hidep" }, { key: "t", name: "Transparency", num: true, cls: "hidep" }, { key: "d", name: "Off target ′", num: true, cls: "hidep" }]} rows=${report.targets.flatMap((target) => (target.quality?.length ? target.quality : [{}]).map((quality) => ({ ...target, ...quality })))} keyOf=${(row) => `${row.object} ${row.filter}`}
      cells=${(row) => html`<td class="k">${row.object}</td><td>${row.filter ?? "—"}</td><td class="num">${row.frames_counted ?? 0} of ${row.frames_asked ?? "—"}</td><td class="num">${duration(row.exposure_s)}</td>${[["fwhm_arcsec", ""], ["ellipticity", "hidep"], ["transparency", "hidep"], ["off_target_arcmin", "hidep"]].map(([name, cls]) => html`<td key=${name} class=${`num ${cls}`}>${row[name] != null ? number(row[name], 2) : "—"}</td>`)}`} /><//>
    <div class="grid g2"><${Card} name="Rows" flush><${Table} label="Rows" columns=${[{ key: "r", name: "Row", num: true }, { key: "a", name: "Action" }, { key: "s", name: "Status" }, { key: "f", name: "Frames", num: true }]} rows=${report.rows} keyOf=${(row) => row.row} cells=${(row) => html`<td class="num">${row.row + 1}</td><td class="k">${[row.action, row.object].filter(Boolean).join(" ")}</td><td class="wrap">${row.status}${row.detail ? html` <span class="m">${row.detail}</span>` : ""}</td><td class="num">${row.frames}</td>`} /><//>
      <div class="stack"><${Card} name="Alerts" flush>${report.alerts.length ? html`<${Table} label="Alerts" columns=${[{ key: "t", name: "Raised" }, { key: "p", name: "Priority" }, { key: "c", name: "Cause" }]} rows=${report.alerts} keyOf=${(one) => `${one.id} ${one.raised_utc}`} cells=${(one) => html`<td>${clock(one.raised_utc)}</td><td>${one.priority}</td><td class="wrap">${one.cause ?? one.id}</td>`} />` : html`<p class="m pad">None.</p>`}<//>
        <${Card} name="Orders" flush>${report.orders.length ? html`<${Table} label="Orders" columns=${[{ key: "t", name: "Given" }, { key: "o", name: "Order" }, { key: "b", name: "By" }]} rows=${report.orders} keyOf=${(one) => `${one.at_utc} ${one.order ?? one.command}`} cells=${(one) => html`<td>${clock(one.at_utc)}</td><td>${one.order ?? one.command ?? one.verb}</td><td>${one.by ?? one.from ?? one.operator}</td>`} />` : html`<p class="m pad">Nobody ordered anything.</p>`}<//>
        <${Card} name="Disk"><div class="stats three"><${Stat} name="Frames" value=${report.disk.frames} /><${Stat} name="Written" value=${bytes(report.disk.bytes)} /><${Stat} name="Free" value=${bytes(report.disk.free_bytes)} /><${Stat} name="Headers to complete" value=${report.disk.headers_incomplete} /><${Stat} name="Not measured" value=${report.disk.frames_unmeasured} /></div><//></div></div>`;
}

export function Report({ id, summary }) {
  const { query } = route.value;
  const night = query.get("night") ?? tonight(summary);
  const report = useReport(id, night);
  const beside = (step) => () => go(withQuery({ night: nightOf(dateOf(night) + step * day + 3600e3) }));
  return html`<div class="page-h"><h2>${night ? `Night of ${nightDay(night)}` : "Night"}</h2><span class="grow"></span><button class="btn sm soft" aria-label="Night before" onClick=${beside(-1)}><${Icon} name="left" /></button><button class="btn sm soft" aria-label="Night after" onClick=${beside(1)}><${Icon} name="chev" /></button>
      <a class="btn sm soft" href=${`/api/v1/telescopes/${id}/nights/${night}/report.html`} target="_blank">To print</a><a class="btn sm soft" href=${`/api/v1/telescopes/${id}/nights/${night}/report`} target="_blank">JSON</a></div>
    <${Loaded} of=${report} what="The report">${(data) => html`<${Whole} id=${id} report=${data} />`}<//>`;
}

function Line({ id, night }) {
  const report = useReport(id, night);
  const share = (group) => { const found = report.data?.times.find((one) => one.group === group); return found ? `${number(100 * found.share, 1)} %` : "—"; };
  return html`<tr><td class="k"><a href=${`/t/${id}/report?night=${night}`}>${id}</a> <${Old} of=${report} /></td><td class="wide">${report.data ? html`<${Account} times=${report.data.times} />` : html`<span class="m">${report.error?.message ?? "reading …"}</span>`}</td><td class="num"><b>${share("open_shutter")}</b></td><td class="num">${share("weather")}</td><td class="num">${share("fault")}</td><td class="num">${share("unexplained")}</td><td class="num">${report.data?.disk.frames ?? "—"}</td></tr>`;
}

/** The night of all telescopes. */
export function AllReports() {
  const { query } = route.value;
  const telescopes = [...net.value.values()].filter((one) => !one.shared).sort((a, b) => a.id.localeCompare(b.id));
  // Far from each other, telescopes may have two nights at one moment.
  const nights = query.get("night") ? [query.get("night")] : nightsOf(telescopes.length ? telescopes : [null]);
  const beside = (step) => () => go(withQuery({ night: nightOf(dateOf(nights[0]) + step * day + 3600e3) }));
  if (!nights.length) return html`<p class="m">Connecting …</p>`;
  return html`<div class="page-h"><h1 tabindex="-1">Night of ${nights.map(nightDay).join(" and ")}</h1><span class="grow"></span><button class="btn sm soft" aria-label="Night before" onClick=${beside(-1)}><${Icon} name="left" /></button><button class="btn sm soft" aria-label="Night after" onClick=${beside(1)}><${Icon} name="chev" /></button></div>
    ${telescopes.length ? html`<${Card} name="Where the night went" flush end=${Object.values(CLASS).map(([cls, word]) => html`<span class="nw row desk" key=${cls}><span class=${`sw ${cls}`}></span>${word}</span>`)}><div class="tw" tabindex="0" role="group" aria-label="Table, may scroll sideways"><table><thead><tr><th>Telescope</th><th>Time</th><th class="num">Open</th><th class="num">Weather</th><th class="num">Fault</th><th class="num">Not acc.</th><th class="num">Frames</th></tr></thead><tbody>${telescopes.map((one) => { const night = query.get("night") ?? tonight(one); return html`<${Line} key=${`${one.id} ${night}`} id=${one.id} night=${night} />`; })}</tbody></table></div><//>` : html`<${Empty} icon="report" title="No telescope yet" />`}`;
}
