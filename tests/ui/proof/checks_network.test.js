// What the numbered checks of the pages (tests/ui/checks/network.md) say in seconds, bytes and pictures a second, on a recorded bus and the machine that runs it.
import { after, afterEach, test } from "node:test";
import assert from "node:assert/strict";
import { serveFifty } from "../fifty.js";
import { TEST, becomes, follow, launch, newPage, settled, startRecorded } from "../browser.js";

const ALPHA = "demo/alpha";
const FIVE = ["demo/beta", "ridge/delta", "ridge/epsilon", "ridge/gamma", "ridge/zeta"];
const CRITICAL = { id: "dome-not-closed/dome", priority: "critical", cause: "dome is not verified closed.", consequence: "Rain comes in.", action: "Close it.", raised_utc: "2026-11-27T02:27:00Z" };

const bus = await startRecorded();
const browser = await launch(["--enable-precise-memory-info", "--js-flags=--expose-gc"]);
const recorded = await bus.states();
const copy = (id) => Object.fromEntries(Object.entries(recorded).filter(([key]) => !key.includes("/node/web/")).map(([key, body]) =>
  [key.replace(ALPHA, id), JSON.parse(JSON.stringify(body).replaceAll(ALPHA, id))]));
let page, server;

after(async () => {
  await browser.close();
  await bus.end();
}, TEST);
afterEach(async () => {
  server?.end();
  server = null;
  await page?.close();
  await bus.reset();
}, TEST);

async function openPage(address, options = {}) {
  page = await newPage(browser, { viewport: { width: 1280, height: 900 }, ...options });
  if (address) {
    await page.goto(bus.url + address);
    await settled(page);
  }
}

/** Seconds until the page, which is asked in each of its frames, has what a selector finds, `count` of it. */
const until = (selector, count = 1) => page.evaluate(([wanted, least]) => new Promise((resolve) => {
  const began = performance.now();
  const look = () => (document.querySelectorAll(wanted).length >= least ? resolve((performance.now() - began) / 1000) : requestAnimationFrame(look));
  look();
}), /** @type {const} */ ([selector, count]));

function within(measured, most) {
  console.log(`${measured.toFixed(2)} s of ${most} s`);
  assert.ok(measured <= most, `${measured.toFixed(2)} s is more than ${most} s`);
}

test("six telescopes have their tiles within 2 s", TEST, async () => {
  await bus.put(Object.assign({}, ...FIVE.map(copy)));
  await openPage("/");
  await page.locator('[data-testid="tile"]').nth(5).waitFor();
  const began = performance.now();
  await page.goto(bus.url);
  await until('[data-testid="tile"][data-safety="safe"][data-posture="open"][data-mode]', 6);
  within((performance.now() - began) / 1000, 2);
});

test("a critical alert is on the page within 1 s", TEST, async () => {
  await openPage("/t/demo/alpha/log");
  const shown = until('[data-testid="banner"]');
  await bus.put({ "demo/alpha/observatory/alerts/state": { alerts: [CRITICAL] } });
  within(await shown, 1);
});

test("a server that ends is told within 3.5 s, and the page is live within 10 s when it is back", TEST, async () => {
  await openPage("/t/demo/alpha");
  const lost = until('[data-testid="link-lost"]');
  await bus.stop();
  within(await lost, 3.5);
  await bus.again();
  within(await until('body[data-link="live"] .scope [data-safety="safe"]'), 10);
});

test("a node that falls silent is lost on the page within 30 s, and an alert says so", TEST, async () => {
  await openPage("/nodes");
  await page.locator('[data-node="device/main"][data-quality="fresh"]').waitFor();
  const silent = Object.keys(recorded).filter((key) => key.startsWith("demo/alpha/node/device/main/") || /demo\/alpha\/device\/(?!dome)/.test(key));
  const lost = until('[data-node="device/main"][data-quality="lost"]');
  await bus.put(Object.fromEntries(silent.map((key) => [key, null])));
  within(await lost, 30);
  await follow(page, `${bus.url}/alerts`);
  within(await until('[data-alert="node-silent/device/main"]'), 5);
  await follow(page, `${bus.url}/t/demo/alpha`);
  await becomes(() => page.locator('[data-testid="device"]:not([data-device^="dome/"])').evaluateAll((all) => all.every((one) => one.dataset.quality === "lost") && all.length), (n) => n > 5, "its devices are lost");
});

/** What the page keeps: bytes of its scripts after everything unneeded is gone, elements, and sockets. */
async function kept() {
  const devtools = await page.context().newCDPSession(page);
  for (let i = 0; i < 3; i += 1) await devtools.send("HeapProfiler.collectGarbage");
  const { usedSize } = await devtools.send("Runtime.getHeapUsage");
  await devtools.detach();
  return { bytes: usedSize, elements: await page.evaluate(() => document.querySelectorAll("*").length), sockets: server.topics().filter((topic) => topic === "net").length };
}

/** A page of `count` telescopes, each of which changes `times` times as fast as the page takes it; `heed` looks at it after each round. */
async function flood(count, times, every) {
  await openPage(null);
  server = await serveFifty(page, count);
  await page.goto(bus.url);
  await page.locator('[data-testid="tile"]').nth(count - 1).waitFor();
  const all = [...server.told.values()];
  const change = (n) => server.tell(...all.map((one, i) => ({ ...one, frames: n, figures: { guide_rms_arcsec: 0.3 + ((n * 7 + i) % 40) / 100, fwhm_arcsec: 1.2 + ((n + i) % 30) / 50 }, activity: one.activity.map((action) => ({ ...action, step: `exposing ${n} of ${times}, 60 s, V` })), alerts: n % 20 === i % 20 ? [{ ...CRITICAL, id: `a/${n}`, priority: "advisory" }] : [] })));
  const rounds = async (from, to) => {
    for (let n = from; n < to; n += 1) {
      change(n);
      if (n % every === 0) await becomes(() => page.locator('[data-testid="tile"] .stats dd b', { hasText: String(n) }).count(), (found) => found >= count, "the page keeps up");
    }
    change(to);
    await becomes(() => page.locator('[data-testid="tile"] .stats dd b', { hasText: String(to) }).count(), (found) => found >= count, "the page has all of it");
  };
  // What is made once, such as compiled code, counts as kept.
  await rounds(1, 1000);
  const before = await kept();
  return { before, rounds };
}

test("as many changes as come in an hour at ten times the usual rate leave memory, elements and one socket as they were", TEST, async () => {
  const { before, rounds } = await flood(6, 36_000, 100);
  await rounds(1000, 37_000);
  const now = await kept();
  console.log(JSON.stringify({ before, now }));
  assert.ok(now.bytes - before.bytes < 10e6, `${now.bytes - before.bytes} bytes more`);
  assert.ok(Math.abs(now.elements - before.elements) <= 0.02 * before.elements, `${before.elements} elements, then ${now.elements}`);
  assert.equal(now.sockets, 1);
});

test("the changes of ten minutes of 24 telescopes keep the page quick, and less than 5 MB", TEST, async () => {
  const { before, rounds } = await flood(24, 1000, 10);
  await page.evaluate(() => {
    const tasks = [];
    new PerformanceObserver((list) => tasks.push(...list.getEntries().map((one) => one.duration))).observe({ type: "longtask" });
    Object.assign(window, { tasks });
  });
  // At the rate of a server: one change of each a second, for half a minute.
  for (let n = 1000; n < 1030; n += 1) {
    await rounds(n, n);
    await page.waitForTimeout(1000);
  }
  const tasks = await page.evaluate(() => /** @type {any} */ (window).tasks);
  console.log(`tasks longer than 50 ms in 30 s: ${tasks.map(Math.round).join(" ") || "none"}`);
  assert.ok(tasks.reduce((sum, one) => sum + one, 0) < 100 * 30, `${tasks} ms`);
  await rounds(1030, 1600);
  const now = await kept();
  console.log(JSON.stringify({ before, now }));
  assert.ok(now.bytes - before.bytes < 5e6, `${now.bytes - before.bytes} bytes more`);
});

test("the log scrolls at 50 pictures a second and more", TEST, async () => {
  await openPage(null);
  const served = [];
  await page.routeWebSocket(/\/api\/v1\/ws/, (socket) => { socket.connectToServer(); served.push(socket); });
  await page.goto(`${bus.url}/t/demo/alpha/log`);
  await settled(page);
  const data = Array.from({ length: 2000 }, (_, n) => ({ at_utc: new Date(Date.UTC(2026, 10, 27, 4) + n).toISOString(), level: "info", node: "device/main", telescope: ALPHA, number: 1e6 + n, message: `line ${n}`, fields: { a: n } }));
  served[0].send(JSON.stringify({ op: "event", topic: "log?telescope=demo/alpha", data }));
  await becomes(() => page.locator('[data-testid="lines"] li').count(), 300);
  const pictures = await page.evaluate(() => new Promise((resolve) => {
    const began = performance.now();
    let count = 0;
    const next = () => {
      count += 1;
      document.querySelector("ul.log").scrollTop += count % 160 < 80 ? 60 : -60;
      if (performance.now() - began < 4000) requestAnimationFrame(next);
      else resolve((1000 * count) / (performance.now() - began));
    };
    next();
  }));
  console.log(`${pictures.toFixed(0)} pictures a second`);
  assert.ok(pictures >= 50, `${pictures}`);
});
