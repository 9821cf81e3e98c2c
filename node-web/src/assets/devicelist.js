// The devices of a telescope with what they publish and how old it is.
import { html } from "./lib.js";
import { devicesOf, stateWords, values } from "./devices.js";
import { plain } from "./format.js";
import { Age, Card, Icon, Table } from "./parts.js";

export function Devices({ id, states }) {
  const devices = devicesOf(states);
  const connected = devices.filter((device) => !device.lost).length;
  return html`<${Card} name="Devices" flush testid="devices" end=${`${connected} of ${devices.length} connected`}>
    ${devices.length ? html`<${Table} label="Devices" cls="cards" columns=${[{ key: "d", name: "Device" }, { key: "s", name: "State" }, { key: "v", name: "Values" }, { key: "a", name: "Age", num: true }, { key: "p", name: "Period", num: true, cls: "hidep" }]} rows=${devices} keyOf=${(device) => device.key}
      rowProps=${(device) => ({ "data-quality": device.worth, "data-testid": "device", "data-device": `${device.kind}/${device.name}`, "data-link": device.body.link?.is ?? "unknown" })}
      cells=${(device) => html`<td class="k"><a href=${`/t/${device.site}/${device.telescope}/devices/${device.kind}/${device.name}`}><${Icon} name=${device.icon} />${device.name} <span class="mm">${device.kind}${device.telescope === "shared" ? ", shared" : ""}</span></a></td><td>${device.lost ? html`<b class="ink-p2">no link</b>` : stateWords(device)}</td>
        <td class="full"><span class="row wrap">${values(device).map(([value, unit], i) => html`<span class="nw" key=${i}><b>${value}</b> ${unit}</span>`)}</span></td><td class="num"><${Age} s=${device.age} worth=${device.worth} /></td><td class="num hidep mm">${plain(device.entry.period_s)} s</td>`} />` : html`<p class="m">No device has published yet.</p>`}<//>`;
}
