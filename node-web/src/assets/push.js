// Alerts on this device: the browser subscribes at the push service of its maker, and this server sends there.
import { html, useEffect, useSignal } from "./lib.js";
import { ask, useGet } from "./api.js";
import { clock, day } from "./format.js";
import { Card, Loaded, Segment } from "./parts.js";

/** Why this browser cannot show alerts, and what to do; null where it can. */
function obstacle() {
  if (!globalThis.isSecureContext) return "This page came without https, and browsers take messages from https alone (and from localhost). Give the server a certificate (web.certificate in its file, or a proxy with https), then open this page by https.";
  if (!("serviceWorker" in navigator && "PushManager" in globalThis && "Notification" in globalThis)) return "This browser takes no messages here. On an iPhone or iPad (iOS 16.4 or later) add this page to the home screen (Share, Add to Home Screen), open it from there, and come back to this switch. Elsewhere, use another browser, and no private window.";
  if (Notification.permission === "denied") return "This browser was told to show no messages of this page. Allow them (the sign beside the address, or the settings of the device for this page), then load the page again.";
  return null;
}

/** As the server names a subscription: the first 16 hexadecimal digits of the SHA-256 of its address. */
async function idOf(subscription) {
  const hash = await crypto.subtle.digest("SHA-256", new TextEncoder().encode(subscription.endpoint));
  return [...new Uint8Array(hash, 0, 8)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** What a person calls this browser. */
function deviceName() {
  const of = (names) => names.find((name) => navigator.userAgent.includes(name)) ?? "?";
  return `${of(["Firefox", "Edg", "OPR", "Chrome", "Safari"])} on ${of(["iPhone", "iPad", "Android", "Windows", "Mac", "Linux"])}`;
}

const worker = async () => (await navigator.serviceWorker.getRegistration("/")) ?? Promise.reject(new Error("This browser keeps no part of this page, which messages need: a private window, perhaps."));

async function subscribe(key) {
  if ((await Notification.requestPermission()) !== "granted") throw new Error("The browser shows no messages of this page as long as they are not allowed.");
  const { pushManager } = await worker();
  // What this browser had was for another key, or is no longer known to the server.
  await (await pushManager.getSubscription())?.unsubscribe();
  try {
    return await pushManager.subscribe({ userVisibleOnly: true, applicationServerKey: key });
  } catch (error) {
    throw new Error(`The push service of this browser does not take it: ${error.message}`);
  }
}

function Switch({ telescope, keyOfServer, devices, again }) {
  /** The id of this browser's subscription; null where it has none. */
  const own = useSignal(null);
  const problem = useSignal(null);
  const busy = useSignal(false);
  const chosen = useSignal("high");
  useEffect(() => void worker().then(({ pushManager }) => pushManager.getSubscription()).then(async (found) => { own.value = found && (await idOf(found)); }).catch(() => { /* there is none */ }), []);
  const known = devices.find((one) => one.id === own.value);
  const least = known?.min_priority ?? chosen.value;
  const act = async (work) => {
    [busy.value, problem.value] = [true, null];
    try {
      await work();
    } catch (error) {
      problem.value = error.message;
    }
    busy.value = false;
    again();
  };
  const on = (priority) => act(async () => {
    const subscription = known ? await (await worker()).pushManager.getSubscription() : await subscribe(keyOfServer);
    const body = JSON.stringify({ subscription, key: keyOfServer, device: known?.device ?? deviceName(), min_priority: priority, after_min: known?.after_min ?? 0 });
    const made = await ask("/api/v1/push/subscriptions", { method: "POST", headers: { "Content-Type": "application/json" }, body });
    own.value = made.id;
    if (made.error) problem.value = `The alerts are switched on, but the first message has not reached the push service of this browser: ${made.error}. Send a test message later.`;
  });
  const remove = (id) => act(async () => {
    await ask(`/api/v1/push/subscriptions/${id}`, { method: "DELETE" });
    if (id === own.value) await (await (await worker()).pushManager.getSubscription())?.unsubscribe();
  });
  return html`<div class="stack"><div class="row wrap between"><span>Alerts of ${telescope} on this device</span><${Segment} label="Alerts on this device" options=${[["off", "Off"], ["on", busy.value ? "…" : "On"]]} value=${known ? "on" : "off"} onChange=${(value) => !busy.value && (value === "on") !== Boolean(known) && (known ? remove(own.value) : on(least))} /></div>
    <div class="row wrap between"><span>Which</span><${Segment} label="Which alerts" options=${[["critical", "Critical"], ["high", "High and up"], ["medium", "Medium and up"], ["advisory", "All"]]} value=${least} onChange=${(value) => { chosen.value = value; if (known && !busy.value) on(value); }} /></div>
    ${problem.value && html`<p class="note p2" role="alert"><span class="grow">${problem.value}</span></p>`}
    ${devices.length > 0 && html`<ul class="list">${devices.map((one) => html`<li key=${one.id} class="row wrap between" data-testid="push-device"><span><b>${one.device}</b> <span class="m">${one.user}, ${one.min_priority}${one.min_priority === "critical" ? "" : " and up"}, since ${day(one.since_utc)} ${clock(one.since_utc)}${one === known ? ", this device" : ""}</span></span><button class="btn sm soft" aria-label=${`No more alerts on ${one.device} of ${one.user}`} onClick=${() => remove(one.id)}>Remove</button></li>`)}</ul>`}</div>`;
}

export function DeviceAlerts() {
  const found = useGet("/api/v1/push", 30);
  const why = obstacle();
  return html`<${Card} name="Alerts on this device" testid="push"><p class="m">They come also while this page is closed, encrypted for this device. The first one comes when you switch them on; a test message shows whether they still come.</p>${why ? html`<p class="note p3" role="status"><span class="grow">${why}</span></p>`
    : html`<${Loaded} of=${found} what="The list of devices">${({ telescope, key, devices = [] }) => html`<${Switch} telescope=${telescope} keyOfServer=${key} devices=${devices} again=${found.again} />`}<//>`}<//>`;
}
