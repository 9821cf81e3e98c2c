// Charts on a recorded bus: what they draw beside their lines; and the table that each has, by keyboard, with the chart's own points, which gives CSV.
import { test } from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { TEST, becomes, drawnBy, follow, least, looks, newPage, startRecorded, withBrowser } from "./browser.js";

const TIME = /^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d$/;
const id = "demo/alpha";

const minute = (n) => new Date(Date.parse("2026-11-27T01:55:00Z") + n * 60e3).toISOString();
const CURVE = { object: "WASP-18", filter: "R", camera: "camera", comparison_stars: 4, points: Array.from({ length: 30 }, (_, n) => ({ mid_utc: minute(n), flux: n === 7 ? null : 1 + n / 1000, flux_error: 0.001, fwhm_arcsec: 2 + n / 100, sky_adu: 700 + n, dx_px: n / 50, dy_px: -n / 50, airmass: 1.1 })) };
const [{ run: RUN }] = JSON.parse(readFileSync(join(import.meta.dirname, "../../common/contract/golden/v1/observatory.focus.json"), "utf8"));

const [bus, browser] = await withBrowser(startRecorded());
const states = await bus.states();
await bus.put({ [`${id}/observatory/focus/state`]: { ...states[`${id}/observatory/focus/state`], run: RUN } });
const page = await newPage(browser);
await page.context().grantPermissions(["clipboard-read", "clipboard-write"]);
// The recorded night is too short for a light curve.
await page.route(/\/nights\/\d+\/report$/, async (route) => {
  const response = await route.fetch();
  await route.fulfill({ response, json: { ...(await response.json()), curves: [CURVE] } });
});

/** Opens a page once its charts are there. */
async function open(address) {
  await follow(page, bus.url + address);
  await page.locator(".chart").first().waitFor();
}
const heads = (table) => table.locator("thead th").allTextContents();
const rows = (table) => table.locator("tbody tr").evaluateAll((all) => all.map((row) => [...row.children].map((cell) => cell.textContent)));
/** The button of the chart whose name begins so. */
const toggle = (name) => page.getByRole("button", { name: `Table of values: ${name}` });
/** Opens the table of a chart by keyboard. */
async function table(name) {
  await toggle(name).focus();
  await page.keyboard.press("Enter");
  await becomes(() => toggle(name).getAttribute("aria-expanded"), "true");
  const shown = page.locator(`#${await toggle(name).getAttribute("aria-controls")}`);
  await shown.locator("tbody tr").first().waitFor();
  return shown;
}

test("the weather's chart as a table: each parameter with its unit, and the archive's own points", TEST, async () => {
  await open(`/t/${id}/weather`);
  const shown = await table("Wind");
  const [time, ...rest] = await heads(shown);
  assert.equal(time, "Time, UTC");
  assert.deepEqual(rest.slice(0, 4), ["Wind mean, m/s", "Wind most, m/s", "Wind least, m/s", "Gusts mean, m/s"]);
  const answer = await page.evaluate((telescope) => fetch(`/api/v1/telescopes/${telescope}/series?properties=observingconditions/weather/WindSpeed`).then((r) => r.json()), id);
  const { points } = answer.rows[0].series;
  const found = await becomes(() => rows(shown), (all) => all.length === points.length, `${points.length} rows`);
  assert.ok(found.every(([at]) => TIME.test(at)));
  assert.deepEqual(found.map(([at, mean, most, least]) => [at, mean, most, least]), points.map((one) => [one.at_utc.slice(0, 19).replace("T", " "), one.mean.toFixed(1), one.max.toFixed(1), one.min.toFixed(1)]).reverse(), "the newest first");
  await page.keyboard.press("Enter");
  await shown.waitFor({ state: "detached" });
  await becomes(() => toggle("Wind").getAttribute("aria-expanded"), "false");
});

test("what is zoomed away is not in the table", TEST, async () => {
  await open(`/t/${id}/weather`);
  const shown = await table("Wind");
  const all = Number(await shown.getAttribute("data-rows"));
  const chart = page.locator('[data-testid="chart"]').first();
  await chart.focus();
  for (let i = 0; i < 5; i += 1) await page.keyboard.press("+");
  await page.waitForFunction(([count]) => Number(document.querySelector('[data-testid="numbers"]').dataset.rows) < count, [all]);
  const inView = async () => {
    const [from, to] = await chart.evaluate((one) => [Number(one.dataset.from), Number(one.dataset.to)]);
    return (await rows(shown)).map(([at]) => Date.parse(`${at.replace(" ", "T")}Z`)).every((at) => at > from - 1000 && at <= to);
  };
  await becomes(inView, true, "rows are those of the time that is shown");
});

test("the part of the time that a chart shows stands in the address: a reload and the way back show it again, and other hours begin anew", TEST, async () => {
  await open(`/t/${id}/weather`);
  const chart = page.locator('[data-testid="chart"]').first();
  const shown = () => chart.evaluate((one) => [Number(one.dataset.from), Number(one.dataset.to)]);
  const named = () => { const { searchParams } = new URL(page.url()); return searchParams.has("from") ? ["from", "to"].map((name) => Date.parse(searchParams.get(name))) : null; };
  await chart.focus();
  for (let i = 0; i < 3; i += 1) await page.keyboard.press("+");
  // In the address are whole seconds.
  await becomes(async () => [named(), await shown()], ([told, is]) => told !== null && is[1] - is[0] < 2 * 3600e3 && told.every((t, i) => is[i] - t >= 0 && is[i] - t <= 1000), "the address has it");
  const told = named();
  await page.reload();
  await becomes(shown, told, "after a reload");
  await open(`/t/${id}/guiding`);
  assert.equal(named(), null, "another page has its own");
  await page.goBack();
  await becomes(shown, told, "on the way back");
  await page.getByRole("group", { name: "How far back" }).first().getByRole("button", { name: "24 h", exact: true }).click();
  await becomes(shown, ([from, to]) => to - from > 23.9 * 3600e3, "all of 24 hours");
  assert.deepEqual([named(), new URL(page.url()).searchParams.get("hours")], [null, "24"]);
});

test("guiding, focus and light curve have theirs; what was not measured is a dash with its reason", TEST, async () => {
  await open(`/t/${id}/guiding`);
  const corrections = await page.evaluate((telescope) => fetch(`/api/v1/telescopes/${telescope}/guiding/corrections?limit=3000`).then((r) => r.json()), id);
  const errors = await table("Error");
  assert.deepEqual(await heads(errors), ["Time, UTC", "Error east, px", "Error north, px", "Pulse east, ms", "Pulse north, ms", "FWHM, px", "Stars used"]);
  const counts = async () => {
    const [from, to] = await page.locator('[data-testid="chart"]').evaluate((one) => [Number(one.dataset.from), Number(one.dataset.to)]);
    return [(await rows(errors)).length, corrections.rows.filter(({ correction }) => Date.parse(correction.mid_utc) >= from && Date.parse(correction.mid_utc) <= to).length];
  };
  await becomes(counts, ([found, expected]) => expected > 10 && found === expected, "a row for each correction that is shown");
  assert.deepEqual(await heads(await table("East against north")), ["Time, UTC", "East, px", "North, px", "Pier side"]);

  await open(`/t/${id}/focus`);
  const run = await table("Size of stars");
  assert.deepEqual(await heads(run), ["Position, steps", "HFD, px", "Error", "Stars", "Pass", "Not measured because"]);
  await becomes(() => rows(run), RUN.points.map((one) => [String(one.position), one.value?.toFixed(2) ?? "—", one.error?.toFixed(2) ?? "—", one.stars ? String(one.stars) : "—", one.pass, one.reason ?? ""]));
  await toggle("FWHM").waitFor();

  await open(`/t/${id}/lightcurve`);
  const curve = await table("Flux");
  assert.deepEqual(await heads(curve), ["Time, UTC", "Flux against its median, ppt", "Mean of 5 min, ppt", "FWHM, ″", "Sky, ADU", "Drift x, px", "Drift y, px", "Airmass"]);
  const found = await becomes(() => rows(curve), (all) => all.filter((row) => row[3] !== "").length === CURVE.points.length, "a row for each frame");
  assert.deepEqual(found.find(([at]) => at === "2026-11-27 02:02:00").slice(0, 4), ["2026-11-27 02:02:00", "—", "", "2.07"], "a frame without flux is a dash; where a series has no point nothing stands");
});

test("it is copied as CSV with all digits, also where the browser has only the old way, and else it can be copied by hand", TEST, async () => {
  await open(`/t/${id}/lightcurve`);
  const curve = await table("Flux");
  const copy = () => curve.getByRole("button", { name: "Copy as CSV" }).click();
  const pasted = () => page.evaluate(() => navigator.clipboard.readText());
  await copy();
  await curve.getByText(/^Copied: \d+ rows\.$/).waitFor();
  const text = await pasted();
  const lines = text.trimEnd().split("\n").map((line) => line.split(","));
  assert.deepEqual(lines[0], ["time_utc", "Flux against its median (ppt)", "Mean of 5 min (ppt)", "FWHM (″)", "Sky (ADU)", "Drift x (px)", "Drift y (px)", "Airmass"]);
  assert.deepEqual(lines[1], ["2026-11-27T01:55:00.000Z", lines[1][1], "", "2", "700", "0", "0", "1.1"]);
  assert.equal(lines.length, 1 + Number(await curve.getAttribute("data-rows")));
  assert.ok(lines.every((line) => line.length === lines[0].length));
  assert.deepEqual(lines.slice(1).map(([at]) => at).sort(), lines.slice(1).map(([at]) => at), "what came first is first");
  await page.evaluate(async () => {
    await navigator.clipboard.writeText("before");
    navigator.clipboard.writeText = () => Promise.reject(new Error("no TLS"));
  });
  await copy();
  await page.waitForFunction(async () => (await navigator.clipboard.readText()).startsWith("time_utc"));
  assert.equal(await pasted(), text);
  await page.evaluate(() => { document.execCommand = () => false; });
  await copy();
  await becomes(() => curve.getByRole("textbox").inputValue(), text);
  await curve.getByRole("status").getByText(/does not let/).waitFor();
});

test("a text from the bus is no formula and breaks no line of the CSV", TEST, async () => {
  const text = await page.evaluate(() => import("/assets/numbers.js").then(({ csv }) => csv([{ name: "=cmd|' /C calc'!A0", unit: "a,b" }, { name: "x", digits: 1 }, { name: 'He said "hi"' }], [["@SUM(1)", -1.5, "one\ntwo"], [null, NaN, undefined], [{ tag: "img" }, 1e-9, "+1"]])));
  assert.equal(text, `"'=cmd|' /C calc'!A0 (a,b)",x,"He said ""hi"""\n'@SUM(1),-1.5,"one\ntwo"\n,,\n"{""tag"":""img""}",1e-9,'+1\n`);
});

test("a second that passes makes no table anew", TEST, async () => {
  await open(`/t/${id}/guiding`);
  await table("Error");
  const seconds = [];
  for (let i = 0; i < 4; i += 1) seconds.push(await drawnBy(page));
  assert.ok(least(seconds, "Guiding") > 0, "the page itself is drawn each second");
  assert.equal(least(seconds, "Numbers"), 0);
});

test("the decimals of an axis are as many as tell its values apart", TEST, async () => {
  const told = await page.evaluate(() => import("/assets/format.js").then(({ labels }) => [[0, 5, 10], [733.6, 733.7, 733.8], [0.3, 0.4, 0.1 + 0.4], [-0.05, 0, 0.05], [2.5, 5, 7.5], [12], [], [1e9, 2e9], [0, 1e-7]].map(labels)));
  assert.deepEqual(told, [["0", "5", "10"], ["733.6", "733.7", "733.8"], ["0.3", "0.4", "0.5"], ["−0.05", "0.00", "0.05"], ["2.5", "5.0", "7.5"], ["12"], [], ["1000000000", "2000000000"], ["0.0000", "0.0000"]]);
});

test("a focus run shows the points that could not be measured, the critical zone and the best position", TEST, async () => {
  await open(`/t/${id}/focus`);
  const plane = page.getByRole("img", { name: "Size of stars against the focuser's position" });
  await plane.waitFor();
  await becomes(() => plane.locator(".ln.cross").count(), RUN.points.filter((point) => point.value === undefined).length);
  await becomes(() => plane.locator(".limzone").evaluate((one) => Number(one.getAttribute("width"))), (wide) => wide > 20, "the width of the zone, px");
  await becomes(() => plane.locator(".mark").count(), 1);
  await page.locator("main", { hasText: /critical zone ± 118 steps/ }).waitFor();
});

test("the film of a light curve follows the cursor by whole pieces", TEST, async () => {
  await open(`/t/${id}/lightcurve`);
  const film = page.getByRole("navigation", { name: "Frames around the cursor" });
  await film.waitFor();
  const shown = () => film.locator("a").evaluateAll((all) => all.map((one) => one.getAttribute("href")));
  const current = () => film.locator("a[aria-current]").evaluateAll((all) => all.map((one) => one.getAttribute("href")));
  const last = await becomes(current, (all) => all.length === 1, "one frame is current");
  assert.ok((await shown()).length <= 9 && (await shown()).includes(last[0]));
  // From its end, the cursor goes to the first point.
  await page.locator('[data-testid="chart"]').focus();
  for (let i = 0; i < 100; i += 1) await page.keyboard.press("ArrowLeft");
  await page.waitForFunction((href) => document.querySelector(".film a[aria-current]")?.getAttribute("href") !== href, last[0]);
  await becomes(async () => (await current()).length, 1);
});

/** Shows what `useGet` gives for what `window.asks` says: a path, seconds, and options. */
async function reads(at, path, everyS, options = {}) {
  await at.evaluate(async (asks) => {
    const [{ html, render, signal }, { useGet }] = await Promise.all([import("/assets/lib.js"), import("/assets/api.js")]);
    const Shown = () => {
      const { data, error, loading, worth } = useGet(...window.asks.value);
      return html`<output id="read">${JSON.stringify({ data, error: error?.message ?? null, loading, worth })}</output>`;
    };
    window.asks = signal(asks);
    render(html`<${Shown} />`, document.body.appendChild(document.createElement("div")));
  }, [path, everyS, options]);
  return async () => JSON.parse(await at.locator("#read").textContent());
}
/** Waits until the page has counted so many seconds more. */
async function counts(seconds) {
  const tick = () => page.evaluate(() => import("/assets/store.js").then((store) => store.tick.peek()));
  const until = (await tick()) + seconds;
  await becomes(tick, (now) => now >= until);
}

test("an answer that takes longer than its period is shown, and meanwhile it is not asked again", TEST, async () => {
  await open(`/t/${id}/weather`);
  const [asked, waiting] = [[], []];
  let [under, most, isSlow] = [0, 0, true];
  await page.route(/\/api\/v1\/slow/, async (route) => {
    asked.push(route.request().url());
    under += 1;
    most = Math.max(most, under);
    if (isSlow) await new Promise((resolve) => { waiting.push(resolve); });
    under -= 1;
    await route.fulfill({ json: { of: new URL(route.request().url()).search } });
  });
  const read = await reads(page, "/api/v1/slow?a", 1, { keep: true });
  await becomes(() => asked.length, 1);
  await counts(4);
  assert.equal(asked.length, 1, "in four periods");
  assert.deepEqual(await read(), { data: null, error: null, loading: true, worth: "lost" });
  isSlow = false;
  waiting.splice(0).forEach((answer) => answer());
  await becomes(read, ({ data, loading, worth }) => data?.of === "?a" && !loading && worth === "fresh");
  await becomes(() => asked.length > 2, true, "it goes on");
  assert.equal(most, 1);
  // Another path: what was read stays until its answer has come.
  isSlow = true;
  await page.evaluate(() => { window.asks.value = ["/api/v1/slow?b", 1, { keep: true }]; });
  await becomes(() => asked.at(-1).endsWith("?b"), true);
  await becomes(read, ({ data, loading }) => data?.of === "?a" && loading);
  isSlow = false;
  waiting.splice(0).forEach((answer) => answer());
  await becomes(async () => (await read()).data.of, "?b");
  await page.unroute(/\/api\/v1\/slow/);
});

test("what fails is asked again, later each time; what is not answered at all is an error that says so", TEST, async () => {
  const other = await newPage(browser);
  await other.clock.install();
  // A link that comes back lets nothing wait: this one never comes.
  await other.routeWebSocket(/\/api\/v1\/ws/, () => {});
  await other.goto(bus.url);
  await other.locator("body[data-link]").waitFor();
  let asked = 0;
  let answer = (route) => route.fulfill({ status: 503, json: { title: "Not now", detail: "Not now." } });
  await other.route(/\/api\/v1\/failing/, (route) => { asked += 1; return answer(route); });
  await other.evaluate(() => {
    const { fetch } = window;
    window.times = [];
    window.fetch = (path, options) => { if (path === "/api/v1/failing") window.times.push(performance.now()); return fetch(path, options); };
  });
  const read = await reads(other, "/api/v1/failing", 1);
  await becomes(read, ({ error, loading, worth }) => error === "Not now." && !loading && worth === "lost");
  /** Hurries the page's own clock on until it is asked once more. */
  const askedAgain = async () => {
    const before = asked;
    await becomes(async () => {
      await other.clock.runFor(500);
      return asked > before;
    }, true);
  };
  await askedAgain();
  await askedAgain();
  // By the page's own clock each pause counts from the error; half a second of it is a step of that clock.
  const times = await other.evaluate(() => window.times);
  assert.ok(times[1] - times[0] >= 500 && times[2] - times[1] >= 1500, String(times));
  answer = () => {};
  await askedAgain();
  await other.clock.fastForward(46_000);
  await becomes(async () => (await read()).error, "The server has not answered within 45 s.");
  answer = (route) => route.fulfill({ json: { well: true } });
  await askedAgain();
  await becomes(read, { data: { well: true }, error: null, loading: false, worth: "stale" });
  await other.close();
});

test("a frame that is opened too early, and its pixels, come by themselves", TEST, async () => {
  await open(`/t/${id}`);
  const frame = await page.evaluate((telescope) => fetch(`/api/v1/telescopes/${telescope}/frames?image_type=light&limit=150`).then((r) => r.json()).then(({ rows }) => rows[0].found_frame.id), id);
  const asked = { frame: 0, first: 0 };
  let is = "absent";
  let tilesFail = false;
  await page.route(new RegExp(`/api/.*/frames/${frame}$`), async (route) => {
    asked.frame += 1;
    if (is === "absent") return route.fulfill({ status: 404, json: { title: "Not found", detail: "The archive has no such frame." } });
    const response = await route.fetch();
    const whole = await response.json();
    return route.fulfill({ response, json: is === "new" ? { ...whole, facts: null } : { ...whole, facts: { ...whole.facts, stars: 4321 } } });
  });
  await page.route(/\/tiles\/\d+\/\d+\/\d+$/, (route) => {
    const isFirst = route.request().url().endsWith("/tiles/0/0/0");
    if (isFirst) asked.first += 1;
    return (isFirst ? asked.first === 1 : tilesFail) ? route.fulfill({ status: 503, json: { title: "Busy", detail: "The archive is busy." } }) : route.fallback();
  });
  await page.goto(`${bus.url}/t/${id}/frames/${frame}`);
  await page.getByText("The archive has no such frame.").waitFor();
  await becomes(() => asked.frame >= 2, true);
  is = "new";
  const stars = page.locator(".stat", { has: page.getByText("Stars", { exact: true }) }).locator("b").first();
  await becomes(() => stars.textContent(), "—");
  await page.locator('[data-testid="viewer"]').waitFor();
  assert.ok(asked.first >= 2, "the pixels were refused once");
  is = "measured";
  await becomes(() => stars.textContent(), "4321");
  tilesFail = true;
  await page.getByRole("button", { name: "4:1", exact: true }).click();
  const missing = page.locator('[data-testid="missing-tiles"]');
  await missing.getByText("The archive is busy.").waitFor();
  await missing.getByRole("button", { name: "Try again" }).click();
  await missing.getByText("The archive is busy.").waitFor();
  tilesFail = false;
  await missing.waitFor({ state: "detached" });
  await page.unroute(/\/tiles\/\d+\/\d+\/\d+$/);
});

test("open tables have no serious finding of axe-core in three themes, and fit a phone", TEST, async () => {
  const found = [];
  for (const [address, name] of [["weather", "Wind"], ["focus", "Size of stars"], ["lightcurve", "Flux"]]) {
    await open(`/t/${id}/${address}`);
    await table(name);
    found.push(...(await looks(page, address)));
  }
  assert.deepEqual(found, []);
});
