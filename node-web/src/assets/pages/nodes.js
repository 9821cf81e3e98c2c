// Every node of every telescope: who is silent, where it runs, how full its disk is; and how many keys come as they should.
import { html } from "../lib.js";
import { useGet } from "../api.js";
import { elapsed } from "../elapsed.js";
import { bytes, duration } from "../format.js";
import { Age, Card, Empty, Icon, Loaded, Segment, Table } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { link, net, quality, tick } from "../store.js";

const SORT = { lost: 0, stale: 1, fresh: 2 };

/** All nodes of an answer of `/api/v1/network`, each with the age that its state has now. */
export function nodesOf(answer, received) {
  return [...(answer?.telescopes ?? []), ...(answer?.shared ?? [])].flatMap((summary) => (summary.nodes ?? []).map((node) => {
    const age = node.age_s === null || node.age_s === undefined ? null : node.age_s + (elapsed() - received) / 1000;
    return { ...node, key: `${summary.id} ${node.role} ${node.id}`, telescope: summary.id, age, worth: quality(age, 5) };
  })).sort((a, b) => SORT[a.worth] - SORT[b.worth] || a.key.localeCompare(b.key));
}

const free = (node) => { const found = node.figures?.data_free_gb; return typeof found === "number" ? bytes(found * 1e9) : "—"; };
const FIGURES = /^(data_free_gb|images_free_gb|log_lines_left_out_count|page_url)$/;
const others = (node) => Object.entries(node.figures ?? {}).filter(([name]) => !FIGURES.test(name)).map(([name, value]) => `${name.replaceAll("_", " ")} ${value}`).join(", ");

export function Nodes() {
  tick.value; // eslint-disable-line no-unused-expressions
  const role = route.value.query.get("role") ?? "all";
  const summaries = [...net.value.values()];
  const answer = useGet("/api/v1/network", 5);
  const all = nodesOf(answer.data, answer.at);
  const lost = all.filter((node) => node.worth === "lost").length;
  const shown = all.filter((node) => role === "all" || node.role === role);
  const columns = [{ key: "n", name: "Node", sort: (node) => node.key }, { key: "r", name: "Role", sort: (node) => node.role }, { key: "h", name: "Host", sort: (node) => node.host }, { key: "v", name: "Version", cls: "hidep" }, { key: "u", name: "Up", num: true, sort: (node) => node.uptime_s },
    { key: "d", name: "Disk free", num: true, sort: (node) => node.figures?.data_free_gb }, { key: "l", name: "Lines left out", num: true, cls: "hidep" }, { key: "o", name: "Figures", cls: "hidep" }, { key: "a", name: "Last", num: true, sort: (node) => node.age }];
  return html`<div class="page-h"><h1 tabindex="-1">Nodes</h1><span class="m">${all.length - lost} of ${all.length} live</span>${lost > 0 && html`<span class="ink-p2 nw" data-testid="lost">${lost} lost</span>`}<span class="grow"></span>
      <${Segment} label="Role" options=${[["all", "All"], ["device", "Device"], ["observatory", "Observatory"], ["archive", "Archive"], ["web", "Web"]]} value=${role} onChange=${(value) => go(withQuery({ role: value === "all" ? null : value }), { replace: true })} /></div>
    <div class="grid g3">${summaries.map((summary) => html`<section class="card" key=${summary.id} aria-label=${summary.id}><header><h2>${summary.id}</h2></header><div class="stats"><dl class="stat"><dt>Nodes</dt><dd><b>${summary.node_count.known - summary.node_count.lost}</b> of ${summary.node_count.known}</dd></dl>
      <dl class="stat"><dt>Devices</dt><dd><b>${summary.device_count.known - summary.device_count.lost}</b> of ${summary.device_count.known}</dd></dl><dl class="stat"><dt>Not readable</dt><dd><b>${summary.unreadable?.length ?? 0}</b></dd></dl></div></section>`)}</div>
    <${Loaded} of=${answer} what="The list of nodes">${() => shown.length ? html`<${Card} name="Nodes" flush end="silent ones first"><${Table} label="Nodes" columns=${columns} rows=${shown} keyOf=${(node) => node.key} rowProps=${(node) => ({ "data-quality": node.worth, "data-testid": "node", "data-node": `${node.role}/${node.id}` })}
      cells=${(node) => html`<td class="k"><a href=${`/t/${node.telescope}`}><${Icon} name="nodes" />${node.telescope} ${node.role}/${node.id}</a></td><td>${node.role}</td><td>${node.host || "—"}</td><td class="hidep">${node.version}</td><td class="num">${node.worth === "fresh" && node.uptime_s != null ? duration(node.uptime_s + node.age) : "—"}</td>
        <td class="num">${free(node)}</td><td class="num hidep">${node.figures?.log_lines_left_out_count ?? "—"}</td><td class="hidep m wrap">${others(node)}</td><td class="num">${node.stopped && node.stopped.closed !== false ? html`<span class="m">stopped in good order</span>` : html`<${Age} s=${node.age} worth=${node.worth} never="never" />`}</td>`} /><//>`
      : html`<${Empty} icon="nodes" title="No node">${link.value === "live" ? "None is on the bus with this role." : "Connecting …"}<//>`}<//>`;
}
