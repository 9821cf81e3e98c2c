// What is no longer known is told in the past tense, what is cut is said to be cut, and each answer has the night, the window and the day that it is of.
import { test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { TEST, becomes, fresh, newPage, settled, startRecorded, tooWide, withBrowser } from "./browser.js";

const ID = "demo/alpha";
const [bus, browser] = await withBrowser(startRecorded());
const recorded = await bus.states();
const page = await newPage(browser);
let shift, change;
// The server's clock may be later, and its summaries other ones.
await page.routeWebSocket(/\/api\/v1\/ws$/, (socket) => {
  const server = socket.connectToServer();
  server.onMessage((message) => {
    const told = JSON.parse(String(message));
    if (told.at_utc) told.at_utc = new Date(Date.parse(told.at_utc) + shift).toISOString();
    for (const [id, summary] of Object.entries((told.topic === "net" && told.data.items) || {})) Object.assign(summary, change(id));
    socket.send(JSON.stringify(told));
  });
});

beforeEach(async () => {
  await bus.reset();
  await fresh(page, { viewport: { width: 1280, height: 900 } });
  [shift, change] = [0, (_) => ({})];
}, TEST);

async function open(address) {
  await page.goto(bus.url + address);
  await settled(page);
}
const text = (locator) => locator.evaluate((one) => one.innerText.replace(/\s+/g, " "));

test("the verdict and the guiding of a node that died are told as what they were, and their bars end there", TEST, async () => {
  await open(`/t/${ID}`);
  const safety = page.locator('[data-testid="safety"] header');
  const guiding = page.locator('[data-testid="guiding-card"] header');
  await safety.filter({ hasText: /safe since \d\d:\d\d:\d\d/ }).waitFor();
  await guiding.filter({ hasText: /RMS/ }).waitFor();
  await becomes(() => page.locator('[data-testid="timeline"] .b-gone title', { hasText: "not known since" }).count(), 0, "its bar goes on");
  await bus.put({ [`${ID}/observatory/safety/state`]: null, [`${ID}/observatory/guiding/state`]: null, [`${ID}/observatory/lease/state`]: null });
  await safety.filter({ hasText: /was safe; not known since \d\d:\d\d (stale|lost) .*ago/ }).waitFor();
  await guiding.filter({ hasText: "not known" }).waitFor();
  await page.locator('[data-testid="command"]', { hasText: "In command was" }).waitFor();
  await page.locator('[data-testid="timeline"] .b-gone title', { hasText: /^not known since \d\d:\d\d$/ }).waitFor({ state: "attached" });
  await page.setViewportSize({ width: 390, height: 844 });
  await becomes(() => tooWide(page), null, "it fits a phone");
  await open(`/t/${ID}/weather`);
  const reasons = page.locator('[data-testid="reasons"]');
  await reasons.filter({ hasText: /was safe; not known since \d\d:\d\d/ }).waitFor();
  await reasons.getByText("Every input of the verdict was good then.").waitFor();
  await open(`/t/${ID}/guiding`);
  await page.locator('[data-testid="guiding-now"]', { hasText: "Not known now. It was guiding WASP-18." }).waitFor();
  await bus.put({ [`${ID}/observatory/guiding/state`]: recorded[`${ID}/observatory/guiding/state`] });
  await page.locator('[data-testid="guiding-now"]', { hasText: "Guiding WASP-18." }).waitFor();
});

test("each page asks for the night that the telescope has now, not for that of UTC", TEST, async () => {
  change = () => ({ night: "20261128" });
  const nights = [];
  const note = (request) => { const found = /\/nights\/(\d{8})\/report|[?&]night=(\d{8})/.exec(request.url()); if (found) nights.push(found[1] ?? found[2]); };
  page.on("request", note);
  for (const address of ["", "/focus", "/lightcurve", "/frames", "/report", "/schedule"]) {
    nights.length = 0;
    await open(`/t/${ID}${address}`);
    await becomes(() => [...new Set(nights)], ["20261128"], address);
    await page.locator('[data-testid="night-name"]', { hasText: "night of 28 Nov" }).waitFor();
  }
  for (const address of ["/", "/report", "/frames"]) {
    nights.length = 0;
    await open(address);
    if (address === "/") await page.locator('[data-testid="nights"]').scrollIntoViewIfNeeded();
    await becomes(() => [...new Set(nights)], ["20261128"], address);
  }
  page.off("request", note);
});

test("the window of guiding goes on with the sky, its figures are of no more than it, and what is cut is said", TEST, async () => {
  const froms = [];
  await page.route(/\/guiding\/corrections\?/, (route) => {
    const from = Date.parse(new URL(route.request().url()).searchParams.get("from_utc"));
    froms.push(from);
    // Each minute, from long before what was asked for.
    const rows = Array.from({ length: 76 }, (_, n) => ({ correction: { frame: `f${n}`, mid_utc: new Date(from + (n - 60) * 60e3).toISOString(), pier_side: "east", stars: 9, east: { error_px: n < 60 ? 9 : 0.5 }, north: { error_px: 0.5 } } }));
    return route.fulfill({ json: { rows, truncated: true } });
  });
  await open(`/t/${ID}/guiding`);
  await page.getByRole("button", { name: "15 min" }).click();
  const card = page.getByRole("region", { name: "Where the star went" });
  const stat = async (name) => (await card.locator("dl", { hasText: name }).locator("b").textContent());
  await becomes(async () => Number(await stat("Frames")), (count) => count >= 10 && count <= 16, "those of 15 minutes");
  await becomes(() => stat("RMS east"), "0.50", "of these alone");
  await page.locator('[data-testid="cut"]', { hasText: "these are the newest 76" }).waitFor();
  const before = froms.at(-1);
  shift = 10 * 60e3;
  await becomes(() => froms.at(-1) - before, (later) => later >= 9 * 60e3 && later < 60 * 60e3, "the window moved");
  await page.getByRole("button", { name: "2 h", exact: true }).click();
  await becomes(() => froms.at(-1) - before, (later) => later < 0, "a longer one");
});

test("a card whose answer cannot be read again says of when it is", TEST, async () => {
  let fails = false;
  await page.route(/\/guiding\/corrections\?/, (route) => (fails ? route.fulfill({ status: 503, contentType: "application/problem+json", json: { detail: "The archive is silent." } }) : route.fallback()));
  // The report is read once.
  let reports = 0;
  await page.route(/\/nights\/\d+\/report$/, (route) => { reports += 1; if (reports === 1) return route.fallback(); return undefined; });
  await open(`/t/${ID}`);
  const card = page.locator('[data-testid="guiding-card"]');
  await card.locator(".chart").waitFor();
  await becomes(() => card.locator('[data-testid="old"]').count(), 0);
  fails = true;
  shift = 3 * 60e3;
  await card.locator('[data-testid="old"]', { hasText: /^of \d\d:\d\d, could not be read again$/ }).waitFor();
  const stat = (name) => page.locator('[data-testid="frames-card"] dl', { hasText: name }).locator("b").textContent();
  await becomes(() => stat("Refused"), (told) => told !== "—", "the report is there");
  const taken = async () => Number(await stat("Taken"));
  const count = await becomes(taken, Number.isFinite, "a number");
  const night = recorded[`${ID}/observatory/night/state`];
  await bus.put({ [`${ID}/observatory/night/state`]: { ...night, frames: night.frames + 5 } });
  await becomes(taken, count + 5, "what was announced since the report counts");
});

test("a search that is cut says so, with the archive's own reason, and none of the newest is not none", TEST, async () => {
  let answer;
  await page.route(/\/frames\?/, (route) => route.fulfill({ json: answer }));
  const frame = { id: "f1", at_utc: "2026-11-27T01:00:00Z", object: "WASP-18", filter: "R", image_type: "light", exposure_s: 60, file: "a.fits" };
  answer = { rows: [{ found_frame: frame }], truncated: true };
  await open(`/t/${ID}/frames`);
  await page.locator('[data-testid="cut"]', { hasText: "There are older ones: these are the newest 1." }).waitFor();
  await page.getByLabel("Search frames").fill("no such target");
  await page.locator(".empty", { hasText: "None of the newest 1 fits" }).getByText("There are older ones: name the target exactly.").waitFor();
  answer = { rows: [{ found_frame: frame }], truncated: true, cut: '<img src=x onerror="document.title=1"> ask for a shorter time' };
  await open(`/t/${ID}/frames`);
  await page.locator('[data-testid="cut"]', { hasText: "ask for a shorter time" }).waitFor();
  assert.equal(await page.locator('[data-testid="cut"] img').count(), 0, "a text is no markup");
  answer = { rows: [], truncated: false };
  await open(`/t/${ID}/frames`);
  await page.locator(".empty", { hasText: "No frame fits" }).waitFor();
  assert.equal(await page.locator('[data-testid="cut"]').count(), 0);
});

test("lines of several days have their days, and so has a chart of three", TEST, async () => {
  const line = (at_utc) => ({ log: { at_utc, level: "info", node: "archive/main", message: `written ${at_utc}` } });
  let rows = ["2026-11-27T00:10:00Z", "2026-11-27T00:05:00Z", "2026-11-26T23:50:00Z"].map(line);
  await page.route(/\/log\?/, (route) => (route.request().resourceType() === "document" ? route.fallback() : route.fulfill({ json: { rows, truncated: false } })));
  const days = () => page.locator('[data-testid="lines"] li').evaluateAll((all) => all.map((one) => (one.dataset.testid === "day" ? one.textContent.replace(",", "") : "line")));
  await open(`/t/${ID}/log?at=2026-11-26T23:50:00Z`);
  await page.locator("h2", { hasText: "Around 26 Nov 23:50:00" }).waitFor();
  await becomes(days, ["Fri 27 Nov", "line", "line", "Thu 26 Nov", "line"]);
  await becomes(() => page.locator('[data-testid="lines"] time').first().getAttribute("title"), "2026-11-27T00:10:00Z");
  rows = rows.slice(0, 2);
  await open(`/t/${ID}/log?at=2026-11-27T00:05:00Z`);
  await becomes(days, ["line", "line"], "all of today");
  await open(`/t/${ID}/weather`);
  const chart = page.locator('[data-testid="chart"]').first();
  const reading = () => chart.locator(".read").first().textContent();
  await chart.focus();
  await page.keyboard.press("ArrowLeft");
  await becomes(reading, (found) => /at \d\d:\d\d:\d\d/.test(found), "a time of a few hours");
  await page.getByRole("button", { name: "3 d" }).first().click();
  await becomes(() => chart.evaluate((one) => Number(one.dataset.to) - Number(one.dataset.from)), (span) => span > 71 * 3600e3, "three days");
  await becomes(async () => { await chart.focus(); await page.keyboard.press("ArrowLeft"); return reading(); }, (found) => /at \d+ Nov \d\d:\d\d:\d\d/.test(found), "with its day");
});

test("a site shows its freshest weather station, whoever has it, and how many are silent; nodes of shared equipment are listed", TEST, async () => {
  const weather = `${ID}/device/observingconditions/weather/state`;
  const dead = { ...recorded[weather], link: { is: "lost", reason: "connection closed" } };
  const site = page.locator('[data-testid="site"][aria-label="demo"]');
  await bus.put({ "demo/shared/device/observingconditions/roof/state": dead });
  await open("/");
  await site.locator('[data-testid="stations"]', { hasText: "By alpha/weather; 1 of 2 silent" }).waitFor();
  await becomes(() => site.getByText(/Station silent/).count(), 0);
  // The one that is left belongs to another telescope.
  await bus.put({ [weather]: dead, "demo/beta/device/observingconditions/mast/state": recorded[weather] });
  await site.locator('[data-testid="stations"]', { hasText: "By beta/mast; 2 of 3 silent" }).waitFor();
  assert.match(await text(site), /Wind/);
  await page.route(/\/api\/v1\/network$/, async (route) => {
    const response = await route.fetch();
    const json = await response.json();
    const [one] = json.telescopes;
    return route.fulfill({ response, json: { ...json, shared: [{ ...one, id: "demo/shared", telescope_id: "shared", shared: true, nodes: [{ ...one.nodes[0], role: "device", id: "roof", age_s: 0.5 }] }] } });
  });
  await open("/nodes");
  await page.locator('[data-testid="node"][data-node="device/roof"]', { hasText: "demo/shared" }).waitFor();
});
