// The devices of a telescope with what they publish and how old it is.
import { html } from "./lib.js";
import { devicesOf, stateWords, values } from "./devices.js";
import { plain } from "./format.js";
import { Age, Card, Icon, Table, realTime } from "./parts.js";

export function Devices({ id, states }) {
  const devices = devicesOf(states);
  // The server counts by the same rule, for the cards and the list of nodes: a telescope's own devices, and what of them is lost or silent.
  const count = (list, words) => `${list.filter((device) => device.worth !== "lost").length} of ${list.length} ${words}`;
  const [own, shared] = [devices.filter((device) => device.telescope !== "shared"), devices.filter((device) => device.telescope === "shared")];
  return html`<${Card} name="Devices" flush testid="devices" end=${[own.length && count(own, "devices answer"), shared.length && count(shared, "shared ones")].filter(Boolean).join(", ")}>
    ${devices.length ? html`<${Table} label="Devices" cls="cards" columns=${[{ key: "d", name: "Device" }, { key: "s", name: "State" }, { key: "v", name: "Values" }, { key: "a", name: `Age${realTime()}`, num: true }, { key: "p", name: "Period", num: true, cls: "hidep" }]} rows=${devices} keyOf=${(device) => device.key}
      rowProps=${(device) => ({ "data-quality": device.worth, "data-testid": "device", "data-device": `${device.kind}/${device.name}`, "data-link": device.body.link?.is ?? "unknown" })}
      cells=${(device) => html`<td class="k"><a href=${`/t/${device.site}/${device.telescope}/devices/${device.kind}/${device.name}`}><${Icon} name=${device.icon} />${device.name} <span class="mm">${device.kind}${device.telescope === "shared" ? ", shared" : ""}</span></a></td><td>${device.worth === "lost" ? html`<b class="ink-p2" title=${device.body.link?.reason}>${stateWords(device)}</b>` : stateWords(device)}</td>
        <td class="full"><span class="row wrap">${values(device).map(([value, unit], i) => html`<span class="nw" key=${i}><b>${value}</b> ${unit}</span>`)}</span></td><td class="num"><${Age} s=${device.worth === "lost" ? device.silent : device.age} worth=${device.worth} /></td><td class="num hidep mm">${plain(device.entry.period_s)} s</td>`} />` : html`<p class="m">No device has published yet.</p>`}<//>`;
}
