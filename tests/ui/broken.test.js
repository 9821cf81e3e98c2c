// What the page does when a part of it, a message, or the whole cannot be drawn: it says so in red, and shows nothing old as live.
// The page comes from a real web node; what the server says over the socket is written here.
import { test, before, after, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { binary, comesUp, end, freePort, launch } from "./browser.js";

let node, browser, page, port, folder, socket;

before(async () => {
  port = await freePort();
  folder = mkdtempSync(join(tmpdir(), "starmesh-broken-"));
  const file = join(folder, "observatory.toml");
  writeFileSync(file, `[observatory]\nsite = "paranal"\ntelescope = "io"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n` +
    `elevation_m = 2500\n[bus]\nmulticast = false\n[web]\nlisten = "127.0.0.1:${port}"\n`);
  node = spawn(binary, ["node", "web", "--config", file], { stdio: "ignore" });
  await comesUp(node, port);
  browser = await launch();
}, { timeout: 120_000 });

after(async () => {
  await browser?.close();
  await end(node, "SIGTERM");
  rmSync(folder, { recursive: true, force: true });
}, { timeout: 60_000 });

const summary = (telescope, change = {}) => ({
  id: `paranal/${telescope}`, site_id: "paranal", telescope_id: telescope, shared: false, quality: "fresh",
  safety: { state: "safe", since_utc: "2026-11-22T03:00:00Z", reasons: [], suspended: [], advisories: [] },
  posture: "open", posture_by: "observatory", now: "waits for a schedule", mode: "robotic", simulated: false, speed: 1, ended: false, activity: [], frames: 3, alerts: [],
  alert_counts: { critical: 0, high: 0, medium: 0, advisory: 0 }, device_count: { known: 1, lost: 0 }, node_count: { known: 4, lost: 0 },
  age_s: 0.1, image_age_s: null, reported_utc: "2026-11-22T03:00:00Z", ...change,
});
const says = (op, more) => JSON.stringify({ op, at_utc: new Date().toISOString(), data: { speed: 1 }, ...more });
const net = (op, ...summaries) => says(op, { topic: "net", seq: 1, data: { items: Object.fromEntries(summaries.map((one) => [one.id, one])) } });

beforeEach(async () => {
  await page?.close();
  page = await browser.newPage();
  await page.routeWebSocket(/\/api\/v1\/ws/, (route) => {
    socket = route;
    route.send(says("welcome", { data: { version: "test", speed: 1 } }));
    route.send(net("snap", summary("io"), summary("europa")));
  });
  await page.goto(`http://127.0.0.1:${port}/`);
  await page.locator('[data-telescope="paranal/io"][data-safety="safe"]').waitFor({ timeout: 10_000 });
});

/** Keeps the link alive, as the server's beats do. */
async function beatUntil(done, limit = 10_000) {
  const until = Date.now() + limit;
  while (Date.now() < until) {
    socket.send(says("beat", {}));
    if (await done()) return;
    await page.waitForTimeout(250);
  }
  assert.fail(`not within ${limit} ms: ${await page.locator("body").textContent()}`);
}

test("a tile that cannot be drawn is red and says so, and the others go on", { timeout: 60_000 }, async () => {
  socket.send(net("delta", summary("io", { alerts: null, alert_counts: { critical: 0, high: 0, medium: 0, advisory: 0 } })));
  await page.locator('[data-broken="io"]').waitFor({ timeout: 5000 });
  assert.equal(await page.locator('[data-telescope="paranal/io"]').count(), 0, "its old word is gone");
  assert.equal(await page.locator('[data-telescope="paranal/europa"][data-safety="safe"]').count(), 1);
  socket.send(net("delta", summary("io")));
  await page.locator('[data-telescope="paranal/io"][data-safety="safe"]').waitFor({ timeout: 5000 });
});

test("an object of a payload is text, whatever its fields are called", { timeout: 60_000 }, async () => {
  const trap = { tag: "img", attrs: { src: "x", onerror: "document.title='taken'" }, children: [] };
  const alert = { id: "a", priority: "high", cause: trap, consequence: trap, action: trap, raised_utc: "2026-11-22T03:00:00Z" };
  socket.send(net("delta", summary("io", { alerts: [alert], posture: "open" })));
  await page.locator('[data-telescope="paranal/io"] .top-alert').waitFor({ timeout: 5000 });
  assert.match(await page.locator(".top-alert").first().textContent(), /"tag":"img"/);
  assert.equal(await page.locator(".top-alert img").count(), 0);
  assert.doesNotMatch(await page.title(), /taken/);
});

test("what is not readable on the bus stands on the tile", { timeout: 60_000 }, async () => {
  const unreadable = [{ key: "paranal/io/device/dome/d/state", why: "invalid type" }];
  socket.send(net("delta", summary("io", { unreadable })));
  await page.locator("[data-unreadable]").waitFor({ timeout: 5000 });
});

test("a message that cannot be read ends the link, and nothing is shown as safe", { timeout: 60_000 }, async () => {
  socket.send("{ this is no JSON");
  await page.waitForFunction(() => document.querySelectorAll('[data-safety="safe"]').length === 0 || document.body.dataset.link === "live", null, { timeout: 5000 });
  // it connects again and gets a whole picture
  await page.locator('[data-telescope="paranal/io"][data-safety="safe"]').waitFor({ timeout: 10_000 });
});

test("a page that no longer draws is hidden behind a red bar within seconds", { timeout: 60_000 }, async () => {
  await page.evaluate(() => document.getElementById("clock").remove());
  await beatUntil(() => page.locator("#broken").isVisible());
  assert.equal(await page.locator('[data-telescope="paranal/io"]').isVisible(), false, "the old SAFE is not to be seen");
  assert.match(await page.title(), /^BROKEN/);
});

test("a page whose program never comes says so", { timeout: 60_000 }, async () => {
  await page.route(/app\.js/, (route) => route.abort());
  await page.reload();
  await page.locator("#broken").waitFor({ state: "visible", timeout: 15_000 });
});
