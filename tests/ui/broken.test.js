// What the page does when a part of it, a message, or the whole cannot be drawn: it says so in red, and shows nothing old as live.
// The page comes from a real web node; what the server says over the socket is written here.
import { test, after, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { TEST, becomes, fresh, newPage, startAlone, withBrowser } from "./browser.js";

const [alone, browser] = await withBrowser(startAlone());
const page = await newPage(browser);

const summary = (telescope, change = {}) => ({
  id: `paranal/${telescope}`, site_id: "paranal", telescope_id: telescope, shared: false, quality: "fresh",
  safety: { state: "safe", since_utc: "2026-11-22T03:00:00Z", reasons: [], suspended: [], advisories: [] },
  posture: "open", mode: "robotic", simulated: false, speed: 1, ended: false, activity: [], frames: 3, alerts: [],
  alert_counts: { critical: 0, high: 0, medium: 0, advisory: 0 }, now: "nothing under way", posture_by: "observatory", domes: [], figures: {}, device_count: { known: 1, lost: 0 }, node_count: { known: 4, lost: 0 },
  age_s: 0.1, image_age_s: null, reported_utc: "2026-11-22T03:00:00Z", ...change,
});
const says = (op, more) => JSON.stringify({ op, at_utc: new Date().toISOString(), data: { speed: 1 }, ...more });

/** The server: it says twice a second what it knows, and all of it to a page that connects again, as one on a slow machine may. */
class Server {
  known = new Map();
  sockets = new Set();
  refuses = false;
  beats = setInterval(() => this.send(this.network("delta")), 500);

  serve(socket) {
    if (this.refuses) return void socket.close();
    this.sockets.add(socket);
    socket.onClose(() => this.sockets.delete(socket));
    socket.send(says("welcome", { data: { version: "test", speed: 1 } }));
    socket.send(this.network("snap"));
  }

  network(op) {
    return says(op, { topic: "net", seq: 1, data: { items: Object.fromEntries(this.known) } });
  }

  tell(...summaries) {
    for (const one of summaries) this.known.set(one.id, one);
    this.send(this.network("delta"));
  }

  send(text) {
    for (const socket of this.sockets) socket.send(text);
  }

  stop() {
    clearInterval(this.beats);
    this.sockets.clear();
  }
}

let server;
await page.routeWebSocket(/\/api\/v1\/ws/, (socket) => server.serve(socket));
const tile = (telescope, more = "") => page.locator(`[data-testid="tile"][data-telescope="paranal/${telescope}"]${more}`);
const SAFE = '[data-safety="safe"]';

beforeEach(async () => {
  server?.stop();
  await fresh(page);
  server = new Server();
  server.tell(summary("io"), summary("europa"));
  await page.goto(`${alone.url}/`);
  await tile("io", SAFE).waitFor();
}, TEST);

after(() => server?.stop());

test("a tile that cannot be drawn is red and says so, and the others go on", TEST, async () => {
  server.tell(summary("io", { unreadable: [null] }));
  await page.locator('[data-broken="io"]').waitFor();
  await becomes(() => tile("io").count(), 0, "its old word is gone");
  await tile("europa", SAFE).waitFor();
  server.tell(summary("io"));
  await tile("io", SAFE).waitFor();
});

test("an object in the place of a text becomes no element, whatever its fields are called", TEST, async () => {
  const trap = { tag: "img", type: "img", attrs: { src: "x" }, props: { src: "x", onerror: "document.title='taken'" }, key: null, ref: null, children: [], __k: null, constructor: null };
  const alert = { id: "a", priority: "high", cause: trap, consequence: trap, action: trap, raised_utc: "2026-11-22T03:00:00Z" };
  server.tell(summary("io", { alerts: [alert], alert_counts: { critical: 0, high: 1, medium: 0, advisory: 0 } }));
  await page.locator('[data-testid="banner"]').waitFor();
  assert.equal(await page.locator("#app [onerror], #app img").count(), 0);
  assert.doesNotMatch(await page.title(), /taken/);
  await tile("europa", SAFE).waitFor();
});

test("what is not readable on the bus stands on the tile", TEST, async () => {
  const unreadable = [{ key: "paranal/io/device/dome/d/state", why: "invalid type" }];
  server.tell(summary("io", { unreadable }));
  await page.locator("[data-unreadable]").waitFor();
});

test("a message that cannot be read ends the link, and nothing is shown as safe", TEST, async () => {
  server.refuses = true;
  server.send("{ this is no JSON");
  await page.locator('body[data-link="lost"] [data-testid="link-lost"]').waitFor();
  await becomes(() => page.locator(SAFE).count(), 0, "tiles that say safe");
  await becomes(() => tile("io").count(), 1, "it is shown, as what it was");
  // it connects again and gets a whole picture
  server.refuses = false;
  await tile("io", SAFE).waitFor();
});

test("a page that no longer draws is hidden behind a red bar", TEST, async () => {
  await page.evaluate(() => import("/assets/store.js").then(({ tick }) => Object.defineProperty(tick, "value", { get() { throw new Error("it no longer draws"); } })));
  await page.locator("#broken").waitFor();
  await tile("io").waitFor({ state: "hidden" });
  await page.waitForFunction(() => document.title.startsWith("BROKEN"));
});

test("a page whose program never comes says so", TEST, async () => {
  // A clock that is replaced stays so.
  const own = await newPage(browser);
  await own.clock.install();
  await own.route(/app\.js/, (route) => route.abort());
  await own.goto(`${alone.url}/`);
  await own.clock.runFor(6000);
  await own.locator("#broken").waitFor();
  await own.close();
});
