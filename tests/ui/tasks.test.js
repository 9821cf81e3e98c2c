// What a person with a phone does in the night, from the address that a push message opens: each task within five touches. Typing is none, nor is moving the page up
// and down; drawing a strip of tabs sideways is one.
import { after, test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { createDecipheriv, createECDH, hkdfSync, randomBytes } from "node:crypto";
import http from "node:http";
import { TEST, becomes, newPage, settled, startRecorded, withBrowser } from "./browser.js";

const MOST = 5;
const ID = "demo/alpha";
const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true };
const ALERT = { id: "dome-not-closed/dome", priority: "critical", cause: "dome is not verified closed 90 s after the close command.", consequence: "Rain comes in.", action: "Close it by hand.", raised_utc: "2026-11-27T02:27:00Z" };

/** A push service; what it gets is encrypted for the browser that the test is. */
const messages = [];
const service = http.createServer((request, response) => {
  const parts = [];
  request.on("data", (part) => parts.push(part));
  request.on("end", () => { messages.push(Buffer.concat(parts)); response.writeHead(201).end(); });
});
await new Promise((resolve) => { service.listen(0, "127.0.0.1", () => resolve(null)); });
after(() => {
  service.close();
  service.closeAllConnections();
});
const SERVICE = `http://127.0.0.1:${/** @type {any} */ (service.address()).port}`;
const own = createECDH("prime256v1");
own.generateKeys();
const secret = randomBytes(16);

/** A message as the browser reads it (RFC 8291). */
function read(body) {
  const [salt, theirs, sealed] = [body.subarray(0, 16), body.subarray(21, 21 + body[20]), body.subarray(21 + body[20])];
  const key = hkdfSync("sha256", own.computeSecret(theirs), secret, Buffer.concat([Buffer.from("WebPush: info\0"), own.getPublicKey(), theirs]), 32);
  const part = (name, length) => Buffer.from(hkdfSync("sha256", Buffer.from(key), salt, Buffer.from(`Content-Encoding: ${name}\0`), length));
  const cipher = createDecipheriv("aes-128-gcm", part("aes128gcm", 16), part("nonce", 12)).setAuthTag(sealed.subarray(-16));
  const text = Buffer.concat([cipher.update(sealed.subarray(0, -16)), cipher.final()]);
  return JSON.parse(text.subarray(0, text.lastIndexOf(2)).toString());
}

const [bus, browser] = await withBrowser(startRecorded({ web: `push_services = ["${SERVICE}"]\n` }));
const recorded = await bus.states();
const alarm = () => bus.put({ [`${ID}/observatory/alerts/state`]: { alerts: [ALERT] } });
const { key } = await (await fetch(`${bus.url}/api/v1/push`)).json();
const subscription = { endpoint: `${SERVICE}/phone`, expirationTime: null, keys: { p256dh: own.getPublicKey("base64url"), auth: secret.toString("base64url") } };
const made = await fetch(`${bus.url}/api/v1/push/subscriptions`, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ subscription, key, device: "Chrome on Android" }) });
assert.equal(made.status, 201, await made.text());
await alarm();
/** Where the message about the alert leads, which is where each task begins. */
const { url: opened } = await becomes(() => messages.map(read).find(({ title }) => title.includes(ALERT.id)), Boolean, "the alert is pushed");

const page = await newPage(browser, PHONE);
let touches;

beforeEach(async () => {
  await page.unrouteAll();
  await bus.reset();
  await alarm();
  await page.goto(bus.url + opened);
  await settled(page);
  touches = 0;
}, TEST);

async function touch(what) {
  await what.tap();
  touches += 1;
}

/** Touches a tab of the telescope, once the strip of tabs is drawn so far that a finger meets it. */
async function tab(name) {
  const link = page.locator("nav.tabs").getByRole("link", { name, exact: true });
  const isInView = () => link.evaluate((one) => { const { left, right } = one.getBoundingClientRect(); return (left + right) / 2 > 0 && (left + right) / 2 < innerWidth; });
  if (!await isInView()) touches += 1;
  await touch(link);
}

const within = () => assert.ok(touches <= MOST, `${touches} touches`);

/** The one order that the telescope was asked, by name. */
const ordered = (name) => becomes(async () => (await bus.orders()).find((order) => JSON.stringify(order.do).includes(name)), Boolean, `${name} is ordered`);

test("why is it closed, and until when? No touch: the page that the message opens says so", TEST, async () => {
  const [night, safety] = ["night", "safety"].map((part) => recorded[`${ID}/observatory/${part}/state`]);
  await bus.put({
    [`${ID}/observatory/night/state`]: { ...night, posture: "closed", actions: [] },
    [`${ID}/observatory/safety/state`]: { ...safety, verdict: "unsafe", reasons: [{ input: "weather/Humidity", why: "91 % is above 85 %", clears_in_s: 600 }] },
  });
  await page.locator('[data-testid="now"] [data-testid="reasons"] li', { hasText: /91 % is above 85 %.*can clear \d\d:\d\d:\d\d, in (9|10) min/ }).waitFor();
  assert.equal(touches, 0);
});

test("acknowledge the alert of the message", TEST, async () => {
  await touch(page.locator("nav.bottom").getByRole("link", { name: "Alerts" }));
  await touch(page.locator(`[data-alert="${ALERT.id}"]`).getByRole("button", { name: "Acknowledge" }));
  assert.deepEqual((await ordered("acknowledge")).do, { acknowledge: ALERT.id });
  within();
});

test("close", TEST, async () => {
  await touch(page.locator('[data-testid="close"]:visible').first());
  await touch(page.locator('[data-testid="close-now"]'));
  await ordered("close");
  await page.getByText("not yet verified closed").waitFor();
  within();
});

test("change the schedule, and put it in force", TEST, async () => {
  await tab("Schedule");
  await touch(page.getByRole("button", { name: "Edit a draft" }));
  const area = page.getByLabel("Schedule, rows of JSON");
  const text = await becomes(() => area.inputValue(), (now) => now.includes('"exptime"'), "the schedule in force is read");
  await touch(area);
  await area.fill(text.replace(/"exptime": ?[\d.]+/, '"exptime": 33'));
  await touch(page.getByRole("button", { name: /^Activate/ }));
  await page.getByRole("dialog").getByLabel("Why").fill("shorter, it saturates");
  await touch(page.getByRole("dialog").getByRole("button", { name: "Activate", exact: true }));
  assert.match((await ordered("put_schedule")).do.put_schedule.text, /"exptime": ?33/);
  within();
});

for (const [when, name] of [["last night's", "the night before"], ["tonight's", "the night that the page has"]]) {
  test(`which was ${when} worst frame? Of ${name}`, TEST, async () => {
    const frame = (id, night, fwhm) => ({ found_frame: { id, at_utc: `2026-11-2${night}T02:0${id}:00Z`, object: `star ${id}`, filter: "R", image_type: "light", exposure_s: 60, file: `${id}.fits`, fwhm_arcsec: fwhm } });
    await page.route(/\/frames\?/, (route) => {
      const night = Number(/night=2026112(\d)/.exec(route.request().url())?.[1]) + 1;
      return route.fulfill({ json: { rows: [frame(1, night, 2.5), frame(2, night, null), frame(3, night, night === 6 ? 7.25 : 4.75), frame(4, night, 3)], truncated: false } });
    });
    await touch(page.locator('[data-testid="frames-card"]').getByRole("link", { name: "Frames" }));
    if (when === "last night's") await touch(page.getByRole("button", { name: "Night before" }));
    await page.getByText(when === "last night's" ? "of the night of Wed 25 Nov" : "of the night of Thu 26 Nov").waitFor();
    await touch(page.getByRole("button", { name: "List" }));
    await touch(page.getByRole("columnheader", { name: "FWHM" }).getByRole("button"));
    const worst = page.locator('tbody [data-testid="frame"], tr[data-testid="frame"]').first();
    await worst.filter({ hasText: when === "last night's" ? "7.25″" : "4.75″" }).waitFor();
    await touch(worst.getByRole("link"));
    await page.waitForURL(/\/frames\/3$/);
    within();
  });
}

test("where did the last night go? Its report", TEST, async () => {
  await tab("Report");
  await touch(page.getByRole("button", { name: "Night before" }));
  await page.getByRole("heading", { name: "Night of Wed 25 Nov" }).waitFor();
  await page.getByRole("heading", { name: "Where the night went" }).waitFor();
  await page.getByText("Not accounted").first().waitFor();
  within();
});

test("is it guiding, and how well? The page of the message says so, and one touch leads to every pulse", TEST, async () => {
  const card = page.locator('[data-testid="guiding-card"]');
  await card.locator("header", { hasText: /RMS \d+\.\d\d/ }).waitFor();
  assert.equal(touches, 0);
  await touch(card.getByRole("link", { name: "Guiding" }));
  await page.locator('[data-testid="guiding-now"]', { hasText: "Guiding WASP-18." }).waitFor();
  within();
});
