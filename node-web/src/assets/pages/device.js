// One device: every property with its value and age, what it can do, its last command, and its past hours.
import { html } from "../lib.js";
import { devicesOf, known, stateWords, values } from "../devices.js";
import { clock, duration, field, plain } from "../format.js";
import { Age, Card, Empty, Icon, Stat, Table, realTime } from "../parts.js";
import { go, route, withQuery } from "../route.js";
import { quality, skySpeed, tick, useTopic } from "../store.js";
import { Devices } from "../devicelist.js";
import { History } from "../history.js";

/** Age of one reading: by the sender's own two stamps, plus how long ago they came; no clock but the sender's is asked twice. */
function readingAge(device, reading) {
  const apart = (Date.parse(device.entry.at_utc) - Date.parse(reading.at_utc)) / 1000 / (skySpeed() || 1);
  return device.age + Math.max(0, Number.isFinite(apart) ? apart : 0);
}

function Readings({ device, chosen, onChoose }) {
  const rows = [...Object.entries(device.fields).filter(([, value]) => !known(value) && typeof value === "object" && value).map(([name, value]) => [field(name, null)[0], { no_data: value.no_data, at_utc: device.entry.at_utc }]),
    ...Object.entries(device.body.readings ?? {})];
  return html`<${Card} name="Properties" flush end=${`${rows.length} read from the driver`}><${Table} label="Properties" columns=${[{ key: "n", name: "Property", sort: ([name]) => name }, { key: "v", name: "Value" }, { key: "a", name: `Age${realTime()}`, num: true }, { key: "h", name: "" }]} rows=${rows} keyOf=${([name]) => name} rowProps=${([name]) => ({ "data-testid": "reading", "data-reading": name, "aria-selected": name === chosen ? "true" : null })}
    cells=${([name, reading]) => html`<td class="k">${name}</td><td>${"no_data" in reading ? html`<span class="m">— ${reading.no_data}</span>` : html`<b>${plain(reading.value)}</b> ${reading.unit ?? ""}`}</td><td class="num"><${Age} s=${readingAge(device, reading)} worth=${quality(device.age, device.entry.period_s)} /></td>
      <td>${typeof reading.value === "number" && html`<button class="btn sm quiet" aria-label=${`History of ${name}`} onClick=${() => onChoose(name)}><${Icon} name="curve" /></button>`}</td>`} /><//>`;
}

export function DevicePage({ id }) {
  tick.value; // eslint-disable-line no-unused-expressions
  const states = useTopic(`tel/${id}`);
  const [kind, name] = route.value.rest;
  const chosen = route.value.query.get("history");
  if (!kind) return html`<${Devices} id=${id} states=${states} />`;
  const device = devicesOf(states).find((one) => one.kind === kind && one.name === name);
  if (!device) return html`<${Empty} icon="plug" title=${`No device ${kind}/${name}`}>Nothing of it was received. <a href=${`/t/${id}/devices`}>All devices</a><//>`;
  const last = device.body.last_command;
  const can = Object.entries(device.about?.can ?? {});
  return html`<${Card} name=${`${name}, ${kind}`} end=${html`<${Age} s=${device.worth === "lost" ? device.silent : device.age} worth=${device.worth} after=" ago" />`}>
      <div class="row wrap gaps">${[["State", stateWords(device)], ...values(device).map(([value, unit]) => [unit, value])].map(([label, value]) => html`<${Stat} key=${label} name=${label} value=${value} worth=${device.worth} />`)}</div>
      ${device.lost && html`<div class="note p2"><div class="grow"><b>The device has not answered for ${duration(device.silent)}${realTime()}.</b> Its node asks again by itself. <details><summary>What its driver was told</summary>${plain(device.body.link.reason)}</details></div></div>`}
      ${device.about && html`<p class="m">${[device.about.device_name, device.about.driver, device.about.server && `${device.about.server} number ${device.about.number}`, `interface ${device.about.interface_version}`, device.about.simulated && "simulated"].filter(Boolean).join(" · ")}</p>`}
      ${last && html`<p class="m">Last command: <b>${last.verb}</b> by ${last.from} at ${clock(last.taken_utc)}, ${last.outcome?.is}${last.outcome?.reason ? ` (${last.outcome.reason})` : ""}</p>`}<//>
    ${chosen && html`<${History} id=${id} properties=${[`${kind}/${name}/${chosen}`]} title=${chosen} />`}
    <div class="grid g-side"><${Readings} device=${device} chosen=${chosen} onChoose=${(property) => go(withQuery({ history: property }), { replace: true })} />
      <${Card} name="What it can do">${can.length ? html`<dl class="vals2">${can.map(([what, value]) => html`<div class="row between" key=${what}><dt class="m">${field(what, null)[0]}</dt><dd>${field(what, value)[1]}</dd></div>`)}</dl>` : html`<p class="m">It has published no capabilities.</p>`}<//></div>`;
}
