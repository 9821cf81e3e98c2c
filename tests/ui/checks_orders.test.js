// Numbered checks of the pages: orders and their dialogs (CT), the editor of a schedule (SC), and the API behind both (AP). tests/ui/checks/orders.md says which
// check is proven where; here is what no other test proves.
import { test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { PASSWORD, TEST, becomes, follow, newPage, problemsOf, settled, startRecorded, withBrowser } from "./browser.js";

const ID = "demo/alpha";
const WIDE = { width: 1280, height: 900 };
const PHONE = { width: 390, height: 844 };
const NIGHT = `${ID}/observatory/night/state`;
const SAFETY = `${ID}/observatory/safety/state`;
const SCHEDULE = `${ID}/observatory/schedule/state`;
const DOME = `${ID}/device/dome/dome/state`;

const [bus, browser] = await withBrowser(startRecorded({ web: "requests_per_s = 1000\n" }));
const recorded = await bus.states();
/** What the web node has sent over the socket. */
const sent = [];
/** Orders that the page has sent. */
let asked = 0;
const page = await newPage(browser, { viewport: WIDE });
const problems = problemsOf(page);
page.on("websocket", (socket) => socket.on("framereceived", ({ payload }) => sent.push(String(payload))));
page.on("request", (request) => { asked += request.method() === "POST" && request.url().endsWith("/commands"); });
await page.goto(bus.url);
await settled(page);

beforeEach(async () => {
  await page.unrouteAll();
  await page.setViewportSize(WIDE);
  await bus.reset();
  [asked, problems.length] = [0, 0];
}, TEST);

/** A page of the telescope, drawn anew also where it is the one that is shown. */
async function open(address) {
  await follow(page, `${bus.url}/${address === "/" ? "nodes" : ""}`);
  await follow(page, bus.url + address);
}
const dialog = () => page.getByRole("dialog");
const toast = (text) => page.locator(".toast", { hasText: text }).last().waitFor();
const orderRow = (name) => page.locator(`[data-testid="order"][data-order="${name}"]`);
const hold = async (button) => { await button.dispatchEvent("pointerdown"); await dialog().waitFor({ state: "detached" }); };
const within = () => page.evaluate(() => Boolean(document.activeElement.closest("dialog")) || document.activeElement === document.body);

/** What the telescope was asked, once it was asked something; one that was asked again is one. */
async function orders() {
  const all = await becomes(bus.orders, (found) => found.length, "the telescope is asked something");
  return [...new Map(all.map((order) => [order.id, order])).values()];
}

test("from the page of all telescopes two actions close one, on a wide screen and on a phone, and nothing is unlocked before", TEST, async () => {
  for (const size of [WIDE, PHONE]) {
    await bus.reset();
    await page.setViewportSize(size);
    await open("/");
    await page.locator(`[data-testid="tile"][data-telescope="${ID}"]`).getByRole("button", { name: `Close ${ID}` }).click();
    await page.locator('[data-testid="close-now"]').click();
    const [{ key, do: what }, ...more] = await orders();
    assert.deepEqual([key, what, more], [`${ID}/observatory/order`, "close", []], `${size.width} px`);
  }
  assert.deepEqual(problems, []);
});

test("a double click, and a key that is held, send one order", TEST, async () => {
  const button = page.locator('.scope [data-testid="close"]');
  await open(`/t/${ID}`);
  await button.click();
  await page.locator('[data-testid="close-now"]').dblclick();
  assert.equal((await orders()).length, 1);
  await toast("not yet verified closed");
  assert.equal(asked, 1, "by two clicks");

  await open(`/t/${ID}`);
  await bus.reset();
  await button.focus();
  await page.keyboard.down("Enter");
  for (let i = 0; i < 8; i += 1) await page.keyboard.down("Enter");
  await page.keyboard.up("Enter");
  await page.locator('[data-testid="close-now"]:focus').waitFor();
  assert.deepEqual([asked, await bus.orders()], [1, []], "who leans on the key has the dialog, and no order");
  await page.keyboard.down("Enter");
  await dialog().waitFor({ state: "detached" });
  for (let i = 0; i < 8; i += 1) await page.keyboard.down("Enter");
  await page.keyboard.up("Enter");
  assert.equal((await orders()).length, 1);
  assert.deepEqual([asked, await dialog().count()], [2, 0], "by a held key");
});

test("a dialog keeps the focus, leads it back, and is read out with the telescope and what follows", TEST, async () => {
  const client = await page.context().newCDPSession(page);
  await open(`/t/${ID}/controls`);
  await orderRow("start").waitFor();
  for (const [button, name, what] of [[page.locator('.scope [data-testid="close"]'), /demo\/alpha/, /closes the dome.*stays closed until somebody orders start/], [orderRow("start").getByRole("button"), /alpha/, /Work through the schedule/]]) {
    await button.focus();
    await page.keyboard.press("Enter");
    await dialog().waitFor();
    const read = await becomes(async () => {
      const { nodes } = await client.send("Accessibility.getFullAXTree");
      const found = nodes.find(({ role }) => role?.value === "dialog");
      return [found?.name?.value ?? "", found?.description?.value ?? ""];
    }, ([told]) => told !== "", "it has a name");
    assert.match(read[0], name);
    assert.match(read[1], what);
    for (const key of [...Array(9).fill("Tab"), ...Array(5).fill("Shift+Tab")]) {
      await page.keyboard.press(key);
      assert.equal(await within(), true, `${key} leaves the dialog`);
    }
    await page.keyboard.press("Escape");
    await dialog().waitFor({ state: "detached" });
    await becomes(() => button.evaluate((one) => one === document.activeElement), true, "the focus is where it was");
  }
  await client.detach();
  assert.deepEqual(await bus.orders(), []);
});

test("what stands against an order is named with its value, where it is given, in the words of the API and of the answer", TEST, async () => {
  const windy = { input: "weather/WindSpeed", why: "14.2 m/s is above 13.5 m/s", clears_in_s: 600 };
  await bus.put({ [SAFETY]: { ...recorded[SAFETY], verdict: "unsafe", reasons: [windy], time_to_safe_s: 600 } });
  const start = async () => (await (await fetch(`${bus.url}/api/v1/telescopes/${ID}/commands/catalog`)).json()).find(({ command }) => command === "start");
  const { against } = await becomes(start, (order) => order.against.some((text) => text.includes(windy.why)), "the API has it");
  await open(`/t/${ID}/controls`);
  await orderRow("start").filter({ hasText: against.join("; ") }).waitFor();
  await page.locator("section", { has: page.getByRole("heading", { name: "May the dome open?" }) }).locator("li.no", { hasText: windy.why }).waitFor();
  await orderRow("start").getByRole("button").click();
  for (const text of against) await dialog().locator("li.no", { hasText: text }).waitFor();
  await dialog().getByLabel(/^Why/).fill("it clears");
  await hold(dialog().locator(".hold"));
  await toast(`start done: ${against.join("; ")}`);
});

test("who has the telescope is named with time and reason, taking it over is asked for, and it lapses", TEST, async () => {
  const key = `${ID}/observatory/operator-orders/state`;
  const held = (hours) => bus.put({ [key]: { ...recorded[key], control: { from: "cli/ben@pc", reason: "visitors", at_utc: new Date(Date.parse(recorded[NIGHT].at_utc) - hours * 3600e3).toISOString() } } });
  await held(1);
  await open(`/t/${ID}/controls`);
  const start = orderRow("start");
  await start.filter({ hasText: /ben has the telescope since .*\(visitors\): give a reason to take it over/ }).waitFor();
  await start.getByRole("button").click();
  await dialog().locator("li.no", { hasText: "ben has the telescope" }).waitFor();
  await page.keyboard.press("Escape");
  await held(18.5);
  await open(`/t/${ID}/controls`);
  await start.getByRole("button").waitFor();
  await becomes(async () => /ben has/.test(await start.textContent()), false, "after 18 h it is nobody's");
});

test("an override is held, needs its reason and an end, and the audit has who, from where, when, why and what became of it", TEST, async () => {
  await open(`/t/${ID}/controls`);
  await orderRow("override").getByRole("button").click();
  await dialog().getByRole("heading", { name: "Override alpha?" }).waitFor();
  await dialog().getByLabel("Input").fill("weather/Humidity");
  const [most, reason] = [dialog().getByLabel("Minutes"), dialog().getByLabel("Why")];
  assert.deepEqual([await most.getAttribute("max"), await most.inputValue()], ["480", "60"]);
  const button = dialog().locator(".hold");
  await button.dispatchEvent("pointerdown");
  await becomes(() => reason.evaluate((one) => one === document.activeElement && !one.checkValidity()), true, "the reason is asked for");
  assert.deepEqual(await bus.orders(), []);
  await reason.fill("the sensor is wet");
  await hold(button);
  const [order] = await orders();
  assert.deepEqual([order.do, order.reason], [{ override: { input: "weather/Humidity", for_s: 3600 } }, "the sensor is wet"]);

  const record = (number, at_utc, outcome) => ({ audit: { chain: "c", number, at_utc, node: "observatory/alpha/main", host: "dome-pc", from: "web/ana@192.0.2.7", from_host: "desk", id: order.id, device: "", verb: "override", parameters: '{"input":"weather/Humidity","for_s":3600}', reason: "the sensor is wet", outcome, previous: "", sha256: "" } });
  const rows = [record(1, "2026-11-27T02:20:05.000000Z", { is: "accepted" }), record(2, "2026-11-27T02:20:05.500000Z", { is: "refused", detail: "ana may not" })];
  await page.route("**/audit?*", (route) => route.fulfill({ json: { rows, truncated: false } }));
  await open(`/t/${ID}/audit`);
  const line = page.locator('[data-testid="audit-row"]');
  await line.first().waitFor();
  await becomes(() => line.count(), 1, "a command is one line");
  const told = await line.textContent();
  for (const part of [/27 Nov.*02:20:05/, /web\/ana@192\.0\.2\.7.*desk/, /override/, /“the sensor is wet”/, /refused.*ana may not/, /0\.5 s/]) assert.match(told, part);
});

test("an order that nobody answers is never told as done, and the dome's word follows the telescope alone", TEST, async () => {
  const posture = () => page.locator('.scope [data-testid="words"]').getAttribute("data-posture");
  const close = async () => { await page.locator('.scope [data-testid="close"]').click(); await page.locator('[data-testid="close-now"]').click(); };
  await open(`/t/${ID}`);
  await becomes(posture, "open");
  const silence = { type: "/problems/command-unacknowledged", title: "Nobody answered for the telescope", status: 504, detail: "it did not answer within 3 s. Look at the telescope's state before you order again.", code: "command-unacknowledged" };
  await page.route("**/commands", (route) => route.fulfill({ status: 504, contentType: "application/problem+json", json: silence }));
  await close();
  await toast("the close order may not have arrived: it did not answer within 3 s");
  await page.unrouteAll();
  // This one is taken, and its closing is never seen.
  await page.route("**/api/v1/commands/*", async (route) => { const response = await route.fetch(); await route.fulfill({ response, json: { ...await response.json(), state: "failed", detail: "NOT verified closed after 300 s" } }); });
  await close();
  await toast("is NOT verified closed: failed. NOT verified closed after 300 s");
  assert.equal(await posture(), "open");
  assert.equal(await page.getByText("is verified closed").count(), 0);
});

test("the web node ends while a dome closes: the telescope goes on, and the page is told the end of it and what was raised meanwhile, without a load", TEST, async () => {
  await open(`/t/${ID}`);
  await page.evaluate(() => { window.same = true; });
  await page.locator('.scope [data-testid="close"]').click();
  await page.locator('[data-testid="close-now"]').click();
  const [order] = await orders();
  await toast("not yet verified closed");
  const ended = bus.stop();
  await page.locator('body[data-link="lost"]').waitFor();
  await toast("close was accepted, and what became of it cannot be read");
  await ended;
  const { fields } = recorded[DOME];
  const alert = { id: "disk-low/archive", priority: "high", cause: "The disk fills.", consequence: "No room.", action: "Make room.", raised_utc: "2026-11-27T02:29:00.000000Z" };
  await bus.put({ [DOME]: { ...recorded[DOME], fields: { ...fields, shutter: "closed" } }, [NIGHT]: { ...recorded[NIGHT], actions: [], posture: "closed", mode: "manual", last_order: { id: order.id, from: order.from, verb: "close", at_utc: recorded[NIGHT].at_utc } }, [`${ID}/observatory/alerts/state`]: { alerts: [alert] } });
  await bus.again();
  await page.locator('body[data-link="live"]').waitFor();
  await page.locator('.scope [data-testid="words"][data-posture="closed"]').waitFor();
  await page.locator(`[data-testid="now"] [data-alert="${alert.id}"]`).waitFor();
  assert.equal(await page.evaluate(() => window.same), true, "it is the same page");
  assert.equal((await orders()).length, 1, "and nothing was ordered again");
});

const area = (on = page) => on.getByLabel("Schedule, rows of JSON");
const draft = (on = page) => area(on).inputValue();
const press = (name, on = page) => on.getByRole("button", { name, exact: true });

/** The editor with the schedule in force as its draft; no other one is stored. */
async function edit(on = page) {
  await fetch(`${bus.url}/api/v1/telescopes/${ID}/schedule/drafts/page`, { method: "DELETE", headers: { "If-Match": "*" } });
  if (on === page) await open(`/t/${ID}/schedule`);
  else await on.goto(`${bus.url}/t/${ID}/schedule`);
  await settled(on);
  await press("Edit a draft", on).click();
  return becomes(() => draft(on), (text) => text.includes("WASP-79"), "the schedule in force is read");
}

test("each finding stands at its line, and while one error is left nothing is activated", TEST, async () => {
  await page.route("**/schedule/validate", (route) => {
    const lines = route.request().postData().split("\n");
    const findings = lines.flatMap((line, i) => ["WRONG-1", "WRONG-2"].filter((word) => line.includes(word)).map((word) => ({ severity: "error", check: "filter", line: i + 1, column: line.indexOf(word) + 1, field: "filter", what: `"${word}" is in no wheel` })));
    return route.fulfill({ json: { valid: !findings.length, rows: lines.length, errors: findings.length, warnings: 0, findings } });
  });
  const text = await edit();
  const lineOf = (object) => text.split("\n").findIndex((line) => line.includes(object)) + 1;
  await area().fill(text.replace('"filter":"B"', '"filter":"WRONG-1"').replace('"filter":"I"', '"filter":"WRONG-2"'));
  const told = () => page.getByTestId("findings").locator("li").allTextContents();
  await becomes(async () => (await told()).map((one) => one.match(/^line (\d+).*filter.*"(.*)"/)?.slice(1)), [[`${lineOf("WASP-79")}`, "WRONG-1"], [`${lineOf("HATS-6")}`, "WRONG-2"]]);
  await becomes(() => page.locator(".code .n.error").allTextContents(), [lineOf("WASP-79"), lineOf("HATS-6")].map(String), "the numbers of the lines are marked");
  const shut = async () => Promise.all([press("Activate …").isDisabled(), press("Dry run").isDisabled()]);
  assert.deepEqual(await shut(), [true, true]);
  await page.getByText("Activate and the dry run wait for 2 errors below.").waitFor();
  await area().fill(text.replace('"filter":"B"', '"filter":"WRONG-1"'));
  await page.getByText("wait for the error below").waitFor();
  assert.deepEqual(await shut(), [true, true]);
  await area().fill(text);
  await becomes(shut, [false, false], "without errors");
});

test("a schedule that somebody else has put in force meanwhile is not replaced: the draft stays and is compared with that", TEST, async () => {
  const text = await edit();
  const mine = text.replace('"n":20,"filter":"B"', '"n":5,"filter":"B"');
  await area().fill(mine);
  const theirs = text.replace('"filter":"I"', '"filter":"V"');
  let given = 0;
  await page.route("**/commands", (route) => { given += 1; return route.fulfill({ status: 412, contentType: "application/problem+json", json: { type: "/problems/precondition", title: "Another schedule is in force", status: 412, detail: "another schedule is in force since 02:29", code: "precondition" } }); });
  await page.route(`**/api/v1/telescopes/${ID}/schedule`, (route) => route.fulfill({ contentType: "application/jsonl", headers: { etag: '"theirs"' }, body: theirs }));
  await press("Activate …").click();
  await dialog().getByLabel("Why").fill("shorter");
  await dialog().getByRole("button", { name: "Activate", exact: true }).click();
  await toast("not activated: another schedule is in force since 02:29");
  await page.getByTestId("other-in-force").waitFor();
  await page.getByTestId("changes").locator(".del", { hasText: 'filter: "V"' }).waitFor();
  await page.getByTestId("changes").locator(".add", { hasText: "n: 5" }).waitFor();
  assert.deepEqual([given, await draft(), await bus.orders()], [1, mine, []]);
});

test("the dialog names the row that runs and what becomes of it, and another schedule is shown in force only once the telescope has it", TEST, async () => {
  const text = await edit();
  await area().fill(text.replace('"exptime":120.0,"n":20,"filter":"R"', '"exptime":60.0,"n":20,"filter":"R"'));
  await press("Activate …").click();
  await dialog().getByText("object WASP-18 runs and is not in it unchanged: its frame is finished, then it ends.").waitFor();
  await dialog().getByLabel("Why").fill("it saturates");
  await dialog().getByRole("button", { name: "Activate", exact: true }).click();
  await orders();
  await toast("the schedule is done");
  const row = page.locator('[data-testid="schedule-row"][data-row="3"]');
  await row.filter({ hasText: "9 of 20" }).waitFor();
  const schedule = recorded[SCHEDULE];
  await bus.put({ [SCHEDULE]: { ...schedule, sha256: "new", rows: schedule.rows.map((one) => (one.row === 3 ? { ...one, frames: 0, frames_wanted: 40 } : one)) } });
  await row.filter({ hasText: "0 of 40" }).waitFor();
});

test("a picture is no schedule: it is refused in words, and neither the draft nor what is in force changes", TEST, async () => {
  const text = await edit();
  const image = await page.screenshot({ clip: { x: 0, y: 0, width: 20, height: 20 } });
  await page.getByLabel("A file with a schedule").setInputFiles({ name: "night.png", mimeType: "image/png", buffer: image });
  await page.getByText("night.png is no text in UTF-8").waitFor();
  assert.deepEqual([await draft(), await bus.orders()], [text, []]);
});

test("fifty steps are taken back and made again, and a tab with a draft that is not stored asks before it closes", TEST, async () => {
  // A page that closes with its context is not asked.
  const context = await browser.newContext({ serviceWorkers: "block", viewport: WIDE });
  const other = await context.newPage();
  const first = await edit(other);
  await area(other).click();
  const text = await area(other).evaluate((one) => {
    for (let i = 1; i <= 50; i += 1) {
      one.value += `// ${i}\n`;
      one.setSelectionRange(one.value.length, one.value.length);
      one.dispatchEvent(new Event("input", { bubbles: true }));
    }
    return one.value;
  });
  await other.getByRole("button", { name: "Undo: typing", exact: true }).waitFor();
  const fifty = (shiftKey) => area(other).evaluate((one, shift) => { for (let i = 0; i < 50; i += 1) one.dispatchEvent(new KeyboardEvent("keydown", { key: "z", ctrlKey: true, shiftKey: shift, bubbles: true, cancelable: true })); }, shiftKey);
  await fifty(false);
  await becomes(() => draft(other), first, "fifty steps back");
  await fifty(true);
  await becomes(() => draft(other), text, "and forward");
  const asking = new Promise((resolve) => { other.once("dialog", resolve); });
  await other.close({ runBeforeUnload: true });
  const question = /** @type {any} */ (await asking);
  assert.equal(question.type(), "beforeunload");
  await question.dismiss();
  assert.equal(await draft(other), text);
  await press("Store", other).click();
  await other.locator('[data-testid="stored"]', { hasText: "stored by" }).waitFor();
  const closed = other.waitForEvent("close");
  await other.close({ runBeforeUnload: true });
  await closed;
  await context.close();
});

test("by the keyboard alone a row is added with its times as numbers, and the draft is activated", TEST, async () => {
  await fetch(`${bus.url}/api/v1/telescopes/${ID}/schedule/drafts/page`, { method: "DELETE", headers: { "If-Match": "*" } });
  await open(`/t/${ID}/schedule`);
  /** Goes on with Tab until what has the focus is called so. */
  const to = async (name, key = "Tab") => {
    for (let i = 0; i < 250; i += 1) {
      const called = await page.evaluate(() => { const one = /** @type {any} */ (document.activeElement); return (one.getAttribute("aria-label") ?? one.labels?.[0]?.textContent ?? one.textContent ?? "").trim(); });
      if (called.startsWith(name)) return;
      await page.keyboard.press(key);
    }
    assert.fail(`${key} never comes to ${name}`);
  };
  const write = async (text) => { await page.keyboard.press("Control+a"); await page.keyboard.type(text); };
  await page.locator("main h1").focus();
  await to("Edit a draft");
  await page.keyboard.press("Enter");
  await becomes(draft, (text) => text.includes("WASP-79"), "the schedule in force is read");
  await to("Add a row");
  await page.keyboard.press("Enter");
  await page.getByTestId("templates").waitFor();
  await to("object");
  await page.keyboard.press("Enter");
  await to("From, UTC");
  await write("2026-11-27T08:45:00Z");
  await to("Until, UTC");
  await write("2026-11-27T08:49:00Z");
  await to("Object");
  await write("TOI-700");
  await to("Put it into the draft");
  await page.keyboard.press("Enter");
  const row = (await becomes(draft, (text) => text.includes("TOI-700"), "it is in the draft")).split("\n").find((line) => line.includes("TOI-700"));
  assert.match(row, /"start_time":"2026-11-27T08:45:00\.?0*Z","end_time":"2026-11-27T08:49:00\.?0*Z"/);
  await to("Activate …", "Shift+Tab");
  await page.keyboard.press("Enter");
  await becomes(() => dialog().getByLabel("Why").evaluate((one) => one === document.activeElement), true, "the reason has the focus");
  await page.keyboard.type("a new planet");
  await page.keyboard.press("Enter");
  const [order] = await orders();
  assert.match(order.do.put_schedule.text, /TOI-700/);
  assert.equal(order.reason, "a new planet");
});

test("altitudes of targets are drawn within a tenth of a degree of where astropy and the dry run have them", TEST, async () => {
  await open(`/t/${ID}`);
  // The highest of the night of 26 November 2026 at -24.6, -70.4 by astropy 7.2.3, without refraction.
  const highest = { "NGC 253": [11.89, -25.29, 89.456], "WASP-18": [24.35, -45.68, 69.056], "WASP-79": [66.37, -30.6, 84.062], "HATS-6": [84.39, -19.03, 84.412], "NGC 2516": [119.52, -60.75, 53.782] };
  const plan = await (await fetch(`${bus.url}/api/v1/telescopes/${ID}/schedule/simulate`, { method: "POST", headers: { "Content-Type": "application/jsonl" }, body: "{}" })).json();
  const runs = plan.rows.filter((row) => row.altitude_curve?.length).map(({ object, altitude_curve: curve }) => [object, curve.map(({ at_utc: at, altitude_deg: altitude }) => [Date.parse(at), altitude])]);
  assert.equal(runs.length, 5);
  const off = await page.evaluate(async ([targets, curves]) => {
    const { altaz, ofDate } = await import("/assets/astro.js");
    const altitude = (name, t) => { const [ra, dec] = targets[name]; return altaz(ofDate({ ra, dec }, t), t, { lat: -24.6, lon: -70.4 }).alt; };
    const times = Array.from({ length: 1201 }, (_, i) => Date.UTC(2026, 10, 27) + i * 30e3);
    return [...Object.entries(targets).map(([name, [, , top]]) => [name, Math.max(...times.map((t) => altitude(name, t))) - top]), ...curves.flatMap(([name, curve]) => curve.map(([t, known]) => [name, altitude(name, t) - known]))];
  }, /** @type {const} */ ([highest, runs]));
  assert.deepEqual(off.filter(([, degrees]) => !(Math.abs(degrees) < 0.1)), []);
});

test("in all that the API and the socket send times have one form, there is no NaN, and a number's name has its unit", TEST, async () => {
  const UNIT = /_(deg|arcsec|arcmin|arcsec_px|px|px_per_s|s|ms|min|h|c|steps|percent|mps|mm_per_h|hpa|lux|mag|mag_per_arcsec2|adu|um|mm|m|bytes|gb|fraction|share|e|e_per_adu|per_step|per_c)$/;
  /** Numbers of things, numbers in an order, shares of one, and what has its unit beside it or none: steps of a focuser, levels of a lamp, relative light; words of JSON Schema and of Astra. */
  const PLAIN = new RegExp(`^(${[
    "n|count|.*_count|.*_counts|critical|high|medium|advisory|errors|warnings|rows|rows_.*|runs|pages|peers|telescopes|frames|frames_.*|stars|.*_stars|stars_.*|matched|corrected|known|lost|states_lost|finished|failed|missing|left|measured|verified|same|sessions|tokens|headers_.*|.*_heard|gaps|points|planes|dropped|most_topics|spooled|filled",
    "number|line|column|end_line|end_column|line_before|line_after|row|version|interface_version|revision|sequence|seq|token|granted_token|pid|id|shape|status|hdu|code|bin|max_bin|z|x|y",
    "airmass|airmass_.*|ellipticity|transparency|false_alarm|phase|moon_lit|speed|gain|share|magnitude|gigabytes|days|bytes|flux|flux_error|brightness|max_brightness",
    "position|.*_position|.*_position_error|.*_offset|focus_offsets|max_step|critical_zone|steps_per_c_error|best_value|value|values|error|min|max|mean|lower|upper",
    "minimum|maximum|minLength|default|example|alt|az|lat|lon|elevation|post_pid_[xy]",
  ].join("|")})$`);
  const wrong = new Set();
  const walk = (value, name, where) => {
    if (Array.isArray(value)) value.forEach((one) => walk(one, name, where));
    else if (value && typeof value === "object") for (const [member, one] of Object.entries(value)) walk(one, member, `${where} ${name}`);
    else if (typeof value === "string" && /_utc$/.test(name) && !/^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,6})?Z$/.test(value)) wrong.add(`${where} ${name}: ${value}`);
    else if (typeof value === "number" && /[a-z]/.test(name) && !/\.|\/|^[A-Z]/.test(name) && !UNIT.test(name) && !PLAIN.test(name)) wrong.add(`${where} ${name}`);
  };
  const answer = async (path) => { const response = await fetch(bus.url + path); return /json/.test(response.headers.get("content-type") ?? "") ? { status: response.status, json: JSON.parse(await response.text()) } : null; };
  const [camera, focuser] = ["camera/camera", "focuser/focuser"].map((device) => `${ID}/device/${device}/state`);
  await bus.put({ [camera]: { ...recorded[camera], fields: { ...recorded[camera].fields, ccd_c: { no_data: "not a number" } } } });
  await bus.raw({ [focuser]: '{"boot_id":"recorded","seq":900000000,"at_utc":"2026-11-27T02:30:00.000000Z","fields":{"temperature_c":NaN}}' });
  await becomes(async () => JSON.stringify(await answer(`/api/v1/telescopes/${ID}/devices/camera/camera`)).includes('"ccd_c":{"no_data":"not a number"'), true, "what was no number has no value");
  const { json: document } = await answer("/api/openapi.json");
  const known = { site: "demo", telescope: "alpha", kind: "dome", device: "dome", name: "dome", camera: "camera", id: "01a218a1-5754-7476-83d3-56cf993d96d8", night: "20261126", version: "1" };
  const paths = Object.entries(document.paths).filter(([path, { get }]) => get && !/\/(ws|users|sessions|tokens|push|docs|openapi|asyncapi|socket)|\.json|tiles|pixels|preview|file|image|header|actions|action-schemas/.test(path)).map(([path]) => path.replaceAll(/\{(\w+)\}/g, (_, name) => known[name] ?? "none"));
  let answered = 0;
  for (const path of paths) {
    const found = await answer(path.endsWith("/series") ? `${path}?properties=observingconditions/weather/WindSpeed` : path);
    answered += found?.status === 200;
    if (found) walk(found.json, "", path);
  }
  assert.ok(answered > 25, `${answered} of ${paths.length}: ${paths}`);
  assert.ok(sent.length > 20);
  for (const text of sent) walk(JSON.parse(text), "", "socket");
  assert.deepEqual([...wrong], []);
});

/** Pages of people with the rights; once there is a user, nobody is let in without a name. */
const people = new Map();
async function signedIn(right) {
  const put = (name, what, cookie) => fetch(`${bus.url}/api/v1/users/${name}`, { method: "PUT", headers: { "Content-Type": "application/json", ...(cookie && { Cookie: cookie }) }, body: JSON.stringify({ rights: [what], password: PASSWORD }) });
  const logIn = (name) => fetch(`${bus.url}/api/v1/login`, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ name, password: PASSWORD }) });
  const cookieOf = (response) => response.headers.getSetCookie()[0].split(";")[0];
  if (!people.size) {
    assert.equal((await put("ana", "engineer")).status, 201);
    people.set("engineer", cookieOf(await becomes(() => logIn("ana"), ({ status }) => status === 200, "ana logs in")));
  }
  if (!people.has(right)) {
    assert.equal((await put(right, right, people.get("engineer"))).status, 201);
    const one = await newPage(browser, { viewport: WIDE });
    const [name, value] = cookieOf(await logIn(right)).split("=");
    await one.context().addCookies([{ name, value, url: bus.url }]);
    await one.goto(`${bus.url}/t/${ID}`);
    await settled(one);
    people.set(right, one);
  }
  return people.get(right);
}

test("observer and operator close with two actions, and a viewer is told which right is missing", TEST, async () => {
  for (const right of ["viewer", "observer", "operator"]) {
    const one = await signedIn(right);
    await one.locator('.scope [data-testid="close"]').click();
    await one.locator('[data-testid="close-now"]').click();
    if (right === "viewer") {
      await one.locator(".toast", { hasText: /close is REFUSED: .*it needs the right observer/ }).waitFor();
      assert.deepEqual(await bus.orders(), []);
      await follow(one, `${bus.url}/t/${ID}/controls`);
      await one.locator('[data-order="start"]', { hasText: "You may not: it needs the right operator." }).waitFor();
      await becomes(() => one.locator('[data-testid="order"] button:enabled').count(), 0, "nothing else can be pressed");
    } else {
      const [order] = await orders();
      assert.deepEqual([order.do, order.from.split("@")[0]], ["close", `web/${right}`]);
      await bus.reset();
    }
  }
});

test("an observer writes and stores a draft and does not activate it, and an operator does", TEST, async () => {
  const observer = await signedIn("observer");
  await follow(observer, `${bus.url}/t/${ID}/schedule`);
  await press("Edit a draft", observer).click();
  const text = await becomes(() => draft(observer), (found) => found.includes("WASP-79"), "the schedule in force is read");
  await area(observer).fill(`${text}// of the observer\n`);
  await press("Store", observer).click();
  await observer.locator('[data-testid="stored"]', { hasText: "stored by observer" }).waitFor();
  await observer.getByText("You may not activate: it needs the right operator.").waitFor();
  assert.equal(await press("Activate …", observer).isDisabled(), true);
  const refused = await observer.evaluate(async ([id, schedule]) => {
    const response = await fetch(`/api/v1/telescopes/${id}/commands`, { method: "POST", headers: { "Content-Type": "application/json", "Idempotency-Key": "1" }, body: JSON.stringify({ command: "put-schedule", parameters: { text: schedule } }) });
    return [response.status, (await response.json()).required_right];
  }, /** @type {const} */ ([ID, text]));
  assert.deepEqual([refused, await bus.orders()], [[403, "operator"], []]);

  const operator = await signedIn("operator");
  await follow(operator, `${bus.url}/t/${ID}/schedule`);
  await press("Edit a draft", operator).click();
  await becomes(() => draft(operator), `${text}// of the observer\n`, "the draft of the observer");
  await press("Activate …", operator).click();
  await operator.getByRole("dialog").getByLabel("Why").fill("reviewed");
  await operator.getByRole("dialog").getByRole("button", { name: "Activate", exact: true }).click();
  const [order] = await orders();
  assert.deepEqual([order.from.split("@")[0], order.reason], ["web/operator", "reviewed"]);
});
