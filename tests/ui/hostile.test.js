// What anybody can put on the bus: markup, very long texts, wrong types, null and numbers that are none, in every field of every payload.
// Nothing of it becomes markup or an address, nothing leads away from the page, and a part that cannot be drawn leaves the others alone.
import { test } from "node:test";
import assert from "node:assert/strict";
import { EVERY, TEST, becomes, everyAddress, follow, fresh, newPage, problemsOf, startRecorded, withBrowser } from "./browser.js";

const MARKUP = '"><img src=x onerror="document.title=\'taken\';window.taken=1"><script>window.taken=1</script><a href="javascript:window.taken=1">{{7*7}}</a>';
const LONG = `${"W".repeat(3000)} ${"long words ".repeat(100)}`;
/** A text that stands for other things: it decides how a page reads the rest, or names what exists. */
const KEPT = new Set(["is", "boot_id", "at_utc", "id", "frame", "verdict", "posture", "status", "priority", "outcome"]);

/** A payload with `poison` in the place of every text of it that is free. */
function poisoned(value, poison, name = "") {
  if (typeof value === "string") return KEPT.has(name) || /^\d{4}-\d\d-\d\d/.test(value) || /utc$/.test(name) ? value : poison;
  if (Array.isArray(value)) return value.map((one) => poisoned(one, poison, name));
  if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([key, one]) => [key, poisoned(one, poison, key)]));
  return value;
}

/** Each value of a payload in turn replaced by something of another type. */
function* mistyped(body) {
  for (const [name, value] of Object.entries(body)) {
    for (const other of [null, MARKUP, -1e308, [[[]]], { tag: "img", props: { src: "x" }, type: "img", __html: MARKUP, constructor: undefined }]) {
      if (typeof other !== typeof value || other === null) yield { ...body, [name]: other };
    }
  }
}

const [bus, browser] = await withBrowser(startRecorded());
const recorded = await bus.states();
const page = await newPage(browser);
const problems = problemsOf(page);
// How many answers the page has asked for and not read yet.
await page.addInitScript(() => {
  const { fetch } = window;
  window.asked = 0;
  window.fetch = async (...given) => {
    window.asked += 1;
    try {
      const answer = await fetch(...given);
      await answer.clone().arrayBuffer();
      return answer;
    } finally {
      window.asked -= 1;
    }
  };
});

/** The page as new, of what the bus has now. */
async function openPage() {
  await fresh(page, { viewport: { width: 390, height: 844 }, problems });
  await page.goto(bus.url);
  await page.locator('[data-testid="tile"][data-telescope="demo/alpha"]').waitFor();
}

/** Every page as it is now, one after the other in a page that is loaded once: nothing was taken over, and the page has not left its own addresses. */
async function looksAtEveryPage(context, told) {
  for (const address of await everyAddress(page)) {
    await context.test(`${told} ${address}`, TEST, async () => {
      await follow(page, bus.url + address);
      await page.waitForFunction(() => window.asked === 0);
      // Whatever else comes: a wait that only a page without Close ends by its limit.
      if (address.startsWith("/t/")) await page.locator('[data-testid="close"]').first().waitFor({ state: "attached" });
      const found = await page.evaluate(() => ({
        taken: Boolean(window.taken) || /taken/.test(document.title), made: document.querySelectorAll("#app img[src=x], #app [onerror], #app script, #app a[href^='javascript'], #app iframe").length,
        elsewhere: [...document.querySelectorAll("#app a[href]")].filter((one) => one.origin !== location.origin).map((one) => one.href),
        wide: document.documentElement.scrollWidth - document.documentElement.clientWidth, path: location.pathname }));
      assert.deepEqual({ ...found, wide: 0 }, { taken: false, made: 0, elsewhere: [], wide: 0, path: address });
      assert.ok(found.wide <= 0, `${found.wide} px too wide`);
    });
  }
  // A part that cannot be drawn says so on the console, as a warning of ours.
  assert.deepEqual(problems.filter((one) => !/cannot be drawn|status of (4|5)\d\d/.test(one)), []);
}

for (const [told, poison] of [["markup in each text:", MARKUP], ...(EVERY ? [["a very long text in each place:", LONG]] : [])]) {
  test(`${told} every page shows it as text`, TEST, async (context) => {
    await bus.reset();
    await bus.put(Object.fromEntries(Object.entries(recorded).map(([key, body]) => [key, poisoned(body, poison)])));
    await bus.events([["demo/alpha/node/device/main/diary", { level: "warn", target: poison, message: poison, fields: { [poison.slice(0, 40)]: poison } }]]);
    await openPage();
    await looksAtEveryPage(context, told);
  });
}

test("values of other types, and payloads that are no JSON, stop nothing else", TEST, async (context) => {
  await bus.reset();
  await openPage();
  const raw = {};
  for (const [key, body] of Object.entries(recorded)) {
    // Of each payload the last of its mistyped forms, by the beat of the player; those that the web node refuses are told with their key.
    const forms = [...mistyped(body)];
    raw[key] = key.endsWith("/rotator/state") ? '{"link": {"is": "live"}, "fields": {"position_deg": NaN, "x": 1e999}, ' : JSON.stringify({ ...forms[forms.length - 1], boot_id: "recorded", seq: 4_000_000_000, at_utc: "2026-11-27T02:28:00Z" });
  }
  await bus.raw(raw);
  await page.goto(bus.url);
  await page.locator("[data-unreadable]").waitFor();
  await looksAtEveryPage(context, "other types:");
  await becomes(() => page.locator('[data-testid="rail-telescope"]').count(), 1, "the telescope is still listed");
  await bus.reset();
});

test("what a page gets over HTTP may have any form: the part says that it cannot be shown, and Close stays", TEST, async (context) => {
  await bus.reset();
  const forms = [null, [], "text", { rows: null }, { rows: [null, 1, MARKUP, { found_frame: null }, { found_frame: { id: MARKUP, at_utc: MARKUP, object: { tag: "img" } } }, { correction: { mid_utc: null, east: MARKUP } }, { series: { kind: MARKUP, points: null } }], times: MARKUP, timeline: null, curves: [{ points: MARKUP }] }];
  // Each request has its own form, another one in the second round.
  const asked = new Map();
  const form = (url, round) => { if (!asked.has(url)) asked.set(url, asked.size); return forms[(asked.get(url) + 3 * round) % forms.length]; };
  for (const round of EVERY ? [0, 1] : [0]) {
    // What several pages share is asked for once.
    await openPage();
    await page.route(/\/api\/v1\/(telescopes|commands|network)/, (route) => (route.request().resourceType() === "fetch"
      ? route.fulfill({ status: 200, contentType: "application/json", body: JSON.stringify(form(new URL(route.request().url()).pathname, round)) }) : route.fallback()));
    await looksAtEveryPage(context, `round ${round}:`);
  }
});
