// What a person with a phone does at 3 am, beginning at the page that a message leads to: each within five touches.
import { test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { TEST, becomes, newPage, settled, startRecorded, withBrowser } from "./browser.js";

const MOST = 5;

const [bus, browser] = await withBrowser(startRecorded());
const page = await newPage(browser, { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true });
let touches;

beforeEach(async () => {
  await bus.reset();
  touches = 0;
  await page.goto(`${bus.url}/t/demo/alpha`);
  await settled(page);
}, TEST);

/** Touches what is shown once. */
async function touch(what) {
  await what.tap();
  touches += 1;
}

const within = () => assert.ok(touches <= MOST, `${touches} touches`);
const tab = (name) => page.locator("nav.tabs").getByRole("link", { name, exact: true });

/** The one order that the telescope was asked, by name. */
async function ordered(name) {
  const asked = await becomes(bus.orders, (all) => all.some((order) => JSON.stringify(order.do).includes(name)), `${name} is ordered`);
  return asked.find((order) => JSON.stringify(order.do).includes(name));
}

test("why is it closed, and until when? The page of the message says so without a touch", TEST, async () => {
  const states = await bus.states();
  const [night, safety] = ["night", "safety"].map((part) => states[`demo/alpha/observatory/${part}/state`]);
  await bus.put({
    "demo/alpha/observatory/night/state": { ...night, posture: "closed", actions: [] },
    "demo/alpha/observatory/safety/state": { ...safety, verdict: "unsafe", reasons: [{ input: "weather/Humidity", why: "91 % is above 85 %", clears_in_s: 600 }] },
  });
  const first = page.locator('[data-testid="now"]');
  await first.getByText("91 % is above 85 %").first().waitFor();
  await first.getByText(/in 10 min|in 9 min/).first().waitFor();
  assert.equal(touches, 0);
});

test("close", TEST, async () => {
  await touch(page.locator('[data-testid="close"]:visible').first());
  await touch(page.locator('[data-testid="close-now"]'));
  await ordered("close");
  await page.getByText("not yet verified closed").waitFor();
  within();
});

test("acknowledge an alert", TEST, async () => {
  const alert = { id: "dome-not-closed/dome", priority: "critical", cause: "It stays open.", consequence: "Rain comes in.", action: "Close it by hand.", raised_utc: "2026-11-27T02:27:00Z" };
  await bus.put({ "demo/alpha/observatory/alerts/state": { alerts: [alert] } });
  await touch(page.locator("nav.bottom").getByRole("link", { name: "Alerts" }));
  await touch(page.locator(`[data-alert="${alert.id}"]`).getByRole("button", { name: "Acknowledge" }));
  assert.match(JSON.stringify((await ordered("acknowledge")).do), /dome-not-closed/);
  within();
});

test("change the schedule, and put it in force", TEST, async () => {
  await touch(tab("Schedule"));
  await touch(page.getByRole("button", { name: "Edit a draft" }));
  const area = page.getByLabel("Schedule, rows of JSON");
  await touch(area);
  const text = await becomes(() => area.inputValue(), (now) => now.includes('"exptime"'), "the schedule in force is read");
  await area.fill(text.replace(/"exptime": ?[\d.]+/, '"exptime": 33'));
  await touch(page.getByRole("button", { name: /^Activate/ }));
  await page.getByRole("dialog").getByRole("textbox").fill("shorter, it saturates");
  await touch(page.getByRole("dialog").getByRole("button", { name: /Activate|Put it in force/ }));
  const order = JSON.stringify((await ordered("put_schedule")).do);
  assert.match(order, /exptime\\*": ?33/);
  within();
});

test("which was last night's worst frame?", TEST, async () => {
  await touch(tab("Frames"));
  await touch(page.getByRole("button", { name: "List" }));
  const head = page.getByRole("columnheader", { name: "FWHM" });
  const first = () => page.locator('[data-testid="frame-row"], tbody tr').first();
  await touch(head.getByRole("button"));
  if ((await head.getAttribute("aria-sort")) !== "descending") await touch(head.getByRole("button"));
  await touch(first().getByRole("link"));
  await page.waitForURL(/\/frames\/.+/);
  within();
});

test("where did the night go?", TEST, async () => {
  await touch(tab("Report"));
  await page.getByText("Where the night went").first().waitFor();
  await page.getByText("Not accounted").first().waitFor();
  within();
});
