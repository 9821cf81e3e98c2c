// Alerts on this device: the switch, what it says where it cannot work, and what the service worker shows. No push service of a browser's
// maker is asked: the subscription is made by the test, a server of the test takes the first message, and Chromium itself delivers others.
import { after, test } from "node:test";
import assert from "node:assert/strict";
import { appendFileSync } from "node:fs";
import http from "node:http";
import { TEST, becomes, newPage, problemsOf, settled, startAlone, withBrowser } from "./browser.js";

const NAME = "dome.example.org";

/** What the push service of the test answers. */
let answers = 201;
const service = http.createServer((request, response) => {
  request.resume();
  request.on("end", () => response.writeHead(answers).end());
});
await new Promise((resolve) => { service.listen(0, "127.0.0.1", () => resolve(null)); });
after(() => {
  service.close();
  service.closeAllConnections();
});
const SERVICE = `http://127.0.0.1:${/** @type {any} */ (service.address()).port}`;

const [site, browser] = await withBrowser(startAlone((file) => appendFileSync(file, `names = ["${NAME}"]\npush_services = ["${SERVICE}"]\n`)), [`--host-resolver-rules=MAP ${NAME} 127.0.0.1`], { whole: true });

async function settings(options, url = site.url, prepare = async (_) => {}) {
  const page = await newPage(browser, { viewport: { width: 390, height: 844 }, ...options });
  await prepare(page);
  await page.goto(`${url}/settings`);
  await settled(page);
  return { page, card: page.locator('[data-testid="push"]') };
}

test("a page without https, and a browser that was told to show nothing, say so and what to do", TEST, async () => {
  const plain = await settings({}, site.url.replace("127.0.0.1", NAME));
  await plain.card.getByText(/came without https.*web\.certificate.*open this page by https/s).waitFor();
  assert.equal(await plain.card.getByRole("button").count(), 0);
  await plain.page.close();
  const told = await settings({}, site.url, (page) => page.addInitScript(() => Object.defineProperty(Notification, "permission", { get: () => "denied" })));
  await told.card.getByText(/was told to show no messages of this page\. Allow them/).waitFor();
  await told.page.close();
});

/** A push service in the page: each browser that subscribes gets an address and keys; one is refused while `refuses` is true. */
const pushService = (page) => page.addInitScript((at) => {
  let subscription = null;
  const text = (bytes) => btoa(String.fromCharCode(...new Uint8Array(bytes))).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  Object.assign(globalThis, { refuses: true });
  PushManager.prototype.getSubscription = async () => subscription;
  PushManager.prototype.subscribe = async () => {
    if (/** @type {any} */ (globalThis).refuses) throw new Error("no network");
    const { publicKey } = await crypto.subtle.generateKey({ name: "ECDH", namedCurve: "P-256" }, true, ["deriveBits"]);
    const keys = { p256dh: text(await crypto.subtle.exportKey("raw", publicKey)), auth: text(crypto.getRandomValues(new Uint8Array(16))) };
    const endpoint = `${at}/${text(crypto.getRandomValues(new Uint8Array(16)))}`;
    subscription = /** @type {any} */ ({ endpoint, toJSON: () => ({ endpoint, expirationTime: null, keys }), unsubscribe: async () => { subscription = null; return true; } });
    return subscription;
  };
}, SERVICE);

test("the switch makes this browser one that gets alerts, changes which, and takes it back", TEST, async () => {
  const { page, card } = await settings({ serviceWorkers: "allow", permissions: ["notifications"] }, site.url, pushService);
  const problems = problemsOf(page);
  const press = (group, name) => card.getByRole("group", { name: group }).getByRole("button", { name, exact: true }).click();
  const devices = async () => (await (await fetch(`${site.url}/api/v1/push`)).json()).devices.map((one) => one.min_priority);
  await card.getByText("Alerts of paranal/io on this device").waitFor();
  await page.evaluate(() => navigator.serviceWorker.ready.then(() => true));
  await press("Alerts on this device", "On");
  await card.getByRole("alert").getByText("The push service of this browser does not take it: no network").waitFor();
  assert.deepEqual(await devices(), []);

  await page.evaluate(() => { Object.assign(globalThis, { refuses: false }); });
  answers = 410;
  await press("Alerts on this device", "On");
  await card.getByRole("alert").getByText(/its push service takes no message for this browser: it answered 410 Gone.*Nothing was stored/s).waitFor();
  assert.deepEqual(await devices(), []);
  answers = 503;
  await press("Alerts on this device", "On");
  await card.getByRole("alert").getByText(/switched on, but the first message has not reached the push service of this browser: it answered 503/).waitFor();
  const row = card.locator('[data-testid="push-device"]', { hasText: /Chrome on Linux.*local, high and up, since .*, this device/s });
  await row.waitFor();
  await press("Alerts on this device", "Off");
  await row.waitFor({ state: "detached" });
  answers = 201;
  await press("Alerts on this device", "On");
  await row.waitFor();
  await card.getByRole("alert").waitFor({ state: "detached" });
  await press("Which alerts", "Critical");
  await becomes(devices, ["critical"]);
  await card.getByText(/local, critical, since/).waitFor();
  await press("Alerts on this device", "Off");
  await becomes(devices, []);
  await row.waitFor({ state: "detached" });
  await card.locator('[aria-label="Alerts on this device"] [aria-pressed="true"]', { hasText: "Off" }).waitFor();
  assert.deepEqual(problems.filter((one) => !/Failed to load resource/.test(one)), []);
  await page.close();
});

test("the service worker shows an alert, and a later message about the same alert in its place", TEST, async () => {
  const { page } = await settings({ serviceWorkers: "allow", permissions: ["notifications"] });
  await page.evaluate(() => navigator.serviceWorker.ready.then(() => true));
  const chromium = await page.context().newCDPSession(page);
  const registered = new Promise((resolve) => { chromium.on("ServiceWorker.workerRegistrationUpdated", ({ registrations }) => registrations.length && resolve(registrations[0].registrationId)); });
  await chromium.send("ServiceWorker.enable");
  const registrationId = await registered;
  const push = (content) => chromium.send("ServiceWorker.deliverPushMessage", { origin: site.url, registrationId, data: JSON.stringify(content) });
  const shown = () => page.evaluate(async () => (await (await navigator.serviceWorker.ready).getNotifications()).map(({ title, body, tag, silent, data }) => ({ title, body, tag, silent: Boolean(silent), data })).sort((a, b) => (a.tag < b.tag ? -1 : 1)));
  const alert = { title: "[paranal/io] critical raised: dome-not-closed/dome", body: "it is half open\nWhat to do: close it", tag: "paranal/io/dome-not-closed/dome", url: "/t/paranal/io", silent: false, stays: true };
  const as = ({ title, body, tag, silent, url }) => ({ title, body, tag, silent, data: { url } });
  // A worker that is only just starting loses a message, and one that comes again takes the place of the first.
  const shownOf = (...all) => async () => {
    for (const one of all) await push(one);
    return shown();
  };
  await becomes(shownOf(alert), [as(alert)]);
  const over = { ...alert, title: "[paranal/io] critical cleared: dome-not-closed/dome", body: "it is half open\nIt is over.", silent: true, stays: false };
  const other = { ...alert, tag: "paranal/io/node-silent/device/enclosure" };
  await becomes(shownOf(over, other), [as(over), as(other)]);
  await page.close();
});
