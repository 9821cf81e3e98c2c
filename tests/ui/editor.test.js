// The editor of a schedule: rows by forms and templates, rows dragged over the night, versions of before, and drafts that nobody loses. Whatever is done to a row,
// the rest of the text stays as it was written.
import { test } from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { TEST, becomes, boxOf, fresh, looks, newPage, problemsOf, settled, startRecorded, tooWide, withBrowser } from "./browser.js";

const ID = "demo/alpha";
const WIDE = { width: 1280, height: 1000 };
const NARROW = { width: 390, height: 844 };
const MARKUP = '"><img src=x onerror="window.taken=1"><script>window.taken=1</script>';
/** A text as people write it: comments, a row over several lines, two ways of writing a time. */
const WRITTEN = `// Tonight, for the supernova.
{"device_name": "camera", "action_type": "open", "action_value": {}, "start_time": "2026-11-27 00:10:00", "end_time": "2026-11-27 08:00:00"}

// The field is crowded:
{"device_name": "camera", "action_type": "object",
 // see the chart
 "action_value": {"object": "SN 2026x", "ra": 24.35, "dec": -45.68, "exptime": 120.0,   "filter": "R"},
 "start_time": "2026-11-27T03:00:00.500Z",   "end_time": "2026-11-27T05:00:00Z"}
// the end`;

const [bus, browser] = await withBrowser(startRecorded());
const wide = await newPage(browser);
const phone = await newPage(browser, { viewport: NARROW, hasTouch: true, isMobile: true });
const problems = new Map([wide, phone].map((one) => [one, problemsOf(one)]));
let page = wide;

const draftPath = () => `${bus.url}/api/v1/telescopes/${ID}/schedule/drafts/page`;
const area = (on = page) => on.getByLabel("Schedule, rows of JSON");
const draft = (on = page) => area(on).inputValue();
const lines = (text) => text.split("\n").filter((line) => line.trim().startsWith("{"));
const button = (name, on = page) => on.getByRole("button", { name, exact: true });
const bar = (number) => page.locator(`[data-testid="draft-bar"][data-row="${number}"]`);

/** A page as new; the draft of the test before is gone, unless the server `keeps` it. */
async function begin({ on = wide, viewport = WIDE, keeps = false } = {}) {
  // The other page would go on drawing meanwhile.
  if (page !== on) await fresh(page);
  page = on;
  await fresh(page, { viewport, problems: problems.get(page) });
  if (!keeps) await fetch(draftPath(), { method: "DELETE", headers: { "If-Match": "*" } });
}

/** The same with the editor open. */
async function open(options = {}) {
  await begin(options);
  await edit();
}

async function edit(on = page) {
  await on.goto(`${bus.url}/t/${ID}/schedule`);
  await settled(on);
  await button("Edit a draft", on).click();
  await becomes(() => draft(on), (text) => lines(text).length > 0, "the draft has rows");
}

/** Writes a text, and waits until its rows are drawn over the night of the site. */
async function write(text, rows) {
  await page.locator('[data-testid="draft-line"] .tw-night').waitFor();
  await area().fill(text);
  await becomes(() => page.locator('[data-testid="draft-bar"]').count(), rows, "each row has its bar");
}

/** Pixels of an hour on the timeline. */
const hourPx = async () => {
  const line = page.getByTestId("draft-line");
  const [{ width }, [from, to]] = [await boxOf(line.locator("svg")), await line.evaluate(({ dataset }) => [Number(dataset.from), Number(dataset.to)])];
  return (width - (width < 560 ? 52 : 78)) / ((to - from) / 3600e3);
};
// That there is no draft yet is answered as 404, and that somebody changed it as 412.
const unexpected = () => problems.get(page).filter((one) => !/status of (404|412)/.test(one));

/** Begin and end of a row of a text, by its object. */
function timesOf(text, object) {
  const row = text.replaceAll(/^\s*\/\/.*$/gm, "").match(new RegExp(`"object":\\s*"${object}"[^]*?"start_time":\\s*"([^"]*)"[^]*?"end_time":\\s*"([^"]*)"`));
  return [row[1], row[2]];
}

test("a row is dragged and its ends are, to whole minutes, and nothing else of the text changes", TEST, async () => {
  await open();
  await write(WRITTEN, 2);
  const px = await hourPx();
  const drag = async (from, by) => {
    await page.mouse.move(from.x, from.y);
    await page.mouse.down();
    await page.mouse.move(from.x + by / 2, from.y, { steps: 3 });
    await page.mouse.move(from.x + by, from.y);
    await page.mouse.up();
  };
  const part = async (share) => { await bar(2).scrollIntoViewIfNeeded(); const { x, y, width, height } = await boxOf(bar(2).locator(".body > rect")); return { x: x + width * share, y: y + height / 2 }; };
  await drag(await part(0.5), px);
  const whole = await becomes(async () => timesOf(await draft(), "SN 2026x"), ([start]) => start !== "2026-11-27T03:00:00.500Z", "the row has other times");
  assert.ok(whole.every((time) => /^2026-11-27T0[3-6]:\d\d:00Z$/.test(time)), `${whole}`);
  assert.equal(Date.parse(whole[1]) - Date.parse(whole[0]), 2 * 3600e3);
  assert.ok(Math.abs(Date.parse(whole[0]) - Date.UTC(2026, 10, 27, 4)) <= 3 * 60e3, "by about an hour");
  assert.equal(await draft(), WRITTEN.replace("2026-11-27T03:00:00.500Z", whole[0]).replace("2026-11-27T05:00:00Z", whole[1]));

  // The row is chosen now, and its ends can be held.
  const end = await boxOf(bar(2).locator('rect.knob[data-part="end"]'));
  await drag({ x: end.x + end.width / 2, y: end.y + end.height / 2 }, px / 2);
  const longer = await becomes(async () => timesOf(await draft(), "SN 2026x"), ([, to]) => to !== whole[1], "the end is later");
  assert.equal(longer[0], whole[0]);
  assert.ok(Math.abs(Date.parse(longer[1]) - Date.parse(whole[1]) - 1800e3) <= 3 * 60e3, `${longer}`);

  // An end stops a minute before the other one.
  const start = await boxOf(bar(2).locator('rect.knob[data-part="start"]'));
  await drag({ x: start.x + 1, y: start.y + start.height / 2 }, 5 * px);
  await becomes(async () => { const [from, to] = timesOf(await draft(), "SN 2026x"); return Date.parse(to) - Date.parse(from); }, 60e3, "a minute is left");

  await button("Undo: start of object SN 2026x").click();
  await becomes(async () => timesOf(await draft(), "SN 2026x"), longer);
  await button("Undo: end of object SN 2026x").click();
  await button("Undo: moving object SN 2026x").click();
  await becomes(draft, WRITTEN, "as it was written");
  await button("Redo: moving object SN 2026x").click();
  await becomes(async () => timesOf(await draft(), "SN 2026x"), whole);
  assert.deepEqual(unexpected(), []);
});

test("arrow keys move a row by a minute and with Shift by ten, an end as well, and one undo takes them back", TEST, async () => {
  await open();
  await write(WRITTEN, 2);
  await bar(2).locator(".body").focus();
  for (const key of ["ArrowRight", "ArrowRight", "Shift+ArrowRight", "ArrowLeft"]) await page.keyboard.press(key);
  await becomes(async () => timesOf(await draft(), "SN 2026x"), ["2026-11-27T03:11:00Z", "2026-11-27T05:11:00Z"]);
  await becomes(() => bar(2).locator(".body").evaluate((one) => one === document.activeElement), true, "it keeps the focus");
  await page.keyboard.press("Tab");
  await page.keyboard.press("Shift+ArrowLeft");
  await becomes(async () => timesOf(await draft(), "SN 2026x"), ["2026-11-27T03:01:00Z", "2026-11-27T05:11:00Z"]);
  await becomes(() => bar(2).locator('.grip[role="slider"]').first().getAttribute("aria-valuetext"), "03:01");
  await button("Undo: start of object SN 2026x").click();
  await button("Undo: moving object SN 2026x").click();
  await becomes(draft, WRITTEN);
  // The row that runs would not go on: it is not in this text.
  await button("Activate …").click();
  await page.getByRole("dialog").locator("p", { hasText: "object WASP-18 runs and is not in it unchanged" }).waitFor();
  await page.keyboard.press("Escape");
  // A key does the same, at a bar and in the text.
  await bar(2).locator(".body").press("Control+Shift+z");
  await becomes(async () => timesOf(await draft(), "SN 2026x"), ["2026-11-27T03:11:00Z", "2026-11-27T05:11:00Z"]);
  await area().press("Control+z");
  await becomes(draft, WRITTEN);
});

test("a finger drags a row on a phone, and beside the rows it looks around", TEST, async () => {
  await open({ on: phone, viewport: NARROW });
  await write(WRITTEN, 2);
  const line = page.getByTestId("draft-line");
  await page.waitForLoadState("networkidle");
  await line.evaluate((one) => one.scrollIntoView({ block: "center" }));
  const px = await hourPx();
  const client = await page.context().newCDPSession(page);
  const touch = (type, ...points) => client.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  const drag = async (x, y, by) => {
    await touch("touchStart", [x, y]);
    for (const share of [0.2, 0.6, 1]) await touch("touchMove", [x + by * share, y]);
    await touch("touchEnd");
  };
  const { x, y, width, height } = await boxOf(bar(2).locator(".body > rect"));
  await drag(x + width / 2, y + height / 2, px / 2);
  const [start, end] = await becomes(async () => timesOf(await draft(), "SN 2026x"), ([from]) => from !== "2026-11-27T03:00:00.500Z", "it is later");
  assert.equal(Date.parse(end) - Date.parse(start), 2 * 3600e3);
  assert.ok(Math.abs(Date.parse(start) - Date.UTC(2026, 10, 27, 3, 30)) <= 5 * 60e3, start);
  const from = () => line.evaluate(({ dataset }) => Number(dataset.from));
  const [before, box] = [await from(), await boxOf(line)];
  await drag(box.x + box.width * 0.6, box.y + 60, 60);
  await becomes(from, (now) => now < before, "what was earlier is shown");
  assert.equal(timesOf(await draft(), "SN 2026x")[0], start);
  await page.getByTestId("undo").click();
  await becomes(draft, WRITTEN);
  assert.equal(await tooWide(page), null);
  assert.deepEqual(unexpected(), []);
});

test("a new row begins with a template of its action: what this telescope did last, its filters, and the darkness that is left", TEST, async () => {
  await open();
  await write(WRITTEN, 2);
  const templates = page.getByTestId("templates");
  const form = page.getByTestId("row-form");
  await page.getByTestId("add-row").click();
  await becomes(() => templates.getByRole("button").count(), 10, "one for each action");
  await templates.getByRole("button", { name: /^object/ }).click();
  const values = (...labels) => Promise.all(labels.map((label) => form.getByLabel(label, { exact: true }).inputValue()));
  assert.deepEqual(await values("Camera", "Object", "Exptime", "Filter", "From, UTC", "Until, UTC"), ["camera", "SN 2026x", "120", "R", "2026-11-27T05:00:00Z", "2026-11-27T07:00:00Z"]);
  assert.deepEqual(await form.getByLabel("Filter", { exact: true }).locator("option").allTextContents(), ["—", "R", "B", "V", "I", "Clear"]);
  await form.getByLabel("Object", { exact: true }).fill("TOI-700");
  await form.getByLabel("Exptime", { exact: true }).fill("30.5");
  await form.getByRole("button", { name: "Put it into the draft" }).click();
  await form.waitFor({ state: "detached" });
  const row = '{"device_name":"camera","action_type":"object","action_value":{"object":"TOI-700","exptime":30.5,"ra":24.35,"dec":-45.68,"filter":"R"},"start_time":"2026-11-27T05:00:00Z","end_time":"2026-11-27T07:00:00Z"}';
  await becomes(draft, WRITTEN.replace("\n// the end", `\n${row}\n// the end`), "it stands behind the last row");

  // Flats come with the light, with as many frames of each filter of the wheel.
  await page.getByTestId("add-row").click();
  await templates.getByRole("button", { name: /^flats/ }).click();
  assert.deepEqual(await values("Filter", "N", "From, UTC"), ['["B","V","R","I","Clear"]', "[10,10,10,10,10]", "2026-11-27T08:19:00Z"]);
  // Another action is another template.
  await form.getByLabel("Action").selectOption("calibration");
  await becomes(() => values("Exptime", "N"), ["[0,30.5,120]", "[10,5,5]"], "darks as long as the frames");
  await page.keyboard.press("Escape");
  assert.deepEqual(unexpected(), []);
});

test("a row is changed by its form wherever it stands, duplicated behind itself, and removed", TEST, async () => {
  await open({ viewport: NARROW });
  await write(WRITTEN, 2);
  await area().evaluate((one, at) => { one.focus(); one.setSelectionRange(at, at); }, WRITTEN.indexOf("see the chart"));
  await area().press("ArrowRight");
  await bar(2).locator(".body").press("Enter");
  const form = page.getByTestId("row-form");
  await form.waitFor();
  await page.keyboard.press("Escape");
  await form.waitFor({ state: "detached" });
  await page.getByTestId("change-row").click();
  await becomes(() => form.getByLabel("Exptime", { exact: true }).inputValue(), "120");
  await form.locator("summary").click();
  await form.getByLabel("N", { exact: true }).fill("12");
  await form.getByLabel("Guiding", { exact: true }).check();
  await form.getByLabel("Filter", { exact: true }).selectOption("");
  await form.getByRole("button", { name: "Change the line" }).click();
  await form.waitFor({ state: "detached" });
  const changed = WRITTEN.replace('120.0,   "filter": "R"}', '120.0, "n": 12, "guiding": true}');
  await becomes(draft, changed, "only what was changed");
  await page.getByTestId("duplicate-row").click();
  const row = changed.slice(changed.indexOf('{"device_name": "camera", "action_type": "object"'), changed.indexOf("\n// the end"));
  const twin = row.replace("03:00:00.500Z", "05:00:00Z").replace(/"end_time": "[^"]*"/, '"end_time": "2026-11-27T07:00:00Z"');
  await becomes(draft, changed.replace("\n// the end", `\n${twin}\n// the end`), "it begins where the other one ends");
  await page.locator('[data-testid="chosen"]', { hasText: "line 9" }).waitFor();
  await page.getByTestId("remove-row").click();
  await becomes(draft, changed);
  await page.getByTestId("undo").click();
  await becomes(async () => lines(await draft()).length, 3, "undone");
  assert.deepEqual(unexpected(), []);
});

test("a version of before is compared, brought back as a draft, and in force only when that is activated with a reason", TEST, async () => {
  await open();
  await bus.reset();
  const inForce = await draft();
  const old = inForce.replace('"exptime":120.0,"n":20,"filter":"B"', '"exptime":60.0,"n":40,"filter":"B"').split("\n").filter((line) => !line.includes("HATS-6")).join("\n");
  const list = [2, 1].map((version) => ({ version, at_utc: "2026-11-26T22:01:33Z", author: `ana${MARKUP}`, reason: `clouds${MARKUP}`, rows: 9, bytes: 10, sha256: `${version}` }));
  await page.route("**/schedule/revisions?*", (route) => route.fulfill({ json: list }));
  await page.route("**/schedule/revisions/2", (route) => route.fulfill({ contentType: "application/jsonl", body: old }));
  await page.reload();
  await settled(page);
  await page.getByRole("button", { name: "Differences of version 2" }).click();
  const version = page.getByTestId("version");
  await version.locator(".del", { hasText: "was object WASP-79 exptime: 120, n: 20" }).waitFor();
  await version.locator(".add", { hasText: "becomes object WASP-79 exptime: 60, n: 40" }).waitFor();
  await version.locator(".del", { hasText: "removed object HATS-6" }).waitFor();
  await becomes(() => version.locator(".add, .del").count(), 3);
  await version.getByRole("button", { name: "Bring this one back …" }).click();
  await becomes(draft, old, "it is the draft");
  await page.getByTestId("changes").locator(".del", { hasText: "HATS-6" }).waitFor();
  assert.deepEqual(await bus.orders(), [], "nothing is ordered");
  await button("Activate …").click();
  const dialog = page.getByRole("dialog");
  await dialog.locator("p", { hasText: "A row that runs goes on." }).waitFor();
  await becomes(() => dialog.getByLabel("Why").inputValue(), "back to version 2");
  await dialog.getByLabel("Why").fill("the clouds are gone");
  await dialog.getByRole("button", { name: "Activate", exact: true }).click();
  const [order] = await becomes(bus.orders, (all) => all.length > 0, "it is ordered");
  assert.deepEqual([order.do.put_schedule, order.reason], [{ text: old, instead_of: (await bus.states())[`${ID}/observatory/schedule/state`].sha256 }, "the clouds are gone"]);
  await button("Edit a draft").click();
  await page.locator('[data-testid="stored"]', { hasText: "as in force" }).waitFor();
  assert.equal(await draft(), inForce, "the next one begins with what is in force");
  assert.equal(await page.evaluate(() => window.taken), undefined);
  assert.deepEqual(unexpected(), []);
});

test("what is written survives a reload, stored or not, and a page that is left", TEST, async () => {
  await open();
  await write(WRITTEN, 2);
  await page.reload();
  await settled(page);
  await button("Edit a draft").click();
  await becomes(draft, WRITTEN, "not stored, and there");
  await page.locator('[data-testid="stored"]', { hasText: "not stored yet" }).waitFor();
  await page.goto(`${bus.url}/t/${ID}/weather`);
  await settled(page);
  await edit();
  await becomes(draft, WRITTEN);
  await button("Store").click();
  await page.locator('[data-testid="stored"]', { hasText: "stored by" }).waitFor();
  await open({ keeps: true });
  await becomes(draft, WRITTEN, "another tab has what was stored");
  await button("Start over").click();
  await becomes(async () => lines(await draft()).length, 10, "as in force");
  await becomes(() => fetch(draftPath()).then((r) => r.status), 404, "and none is stored");
  await page.getByTestId("undo").click();
  await becomes(draft, WRITTEN, "and even that can be undone");
  assert.deepEqual(unexpected(), []);
});

test("of two who edit, the second one is told, and neither text is lost", TEST, async () => {
  await open();
  const other = await newPage(browser, { viewport: WIDE });
  await edit(other);
  const mine = WRITTEN.replace("supernova", "asteroid");
  await area(other).fill(WRITTEN);
  await button("Store", other).click();
  await other.locator('[data-testid="stored"]', { hasText: "stored by" }).waitFor();
  await other.close();
  await write(mine.replace("120.0", "60.0"), 2);
  await button("Store").click();
  const conflict = page.getByTestId("conflict");
  await conflict.waitFor();
  await page.getByRole("group", { name: "Their draft compared with yours" }).locator(".add", { hasText: "exptime: 120" }).waitFor();
  assert.equal(await button("Activate …").isDisabled(), true);
  assert.equal(await draft(), mine.replace("120.0", "60.0"));
  // A reload forgets neither.
  await page.reload();
  await settled(page);
  await button("Edit a draft").click();
  await conflict.waitFor();
  await button("Take theirs").click();
  await becomes(draft, WRITTEN);
  await page.getByTestId("undo").click();
  await becomes(draft, mine.replace("120.0", "60.0"));
  await button("Store").click();
  await page.locator('[data-testid="stored"]', { hasText: "stored by" }).waitFor();

  // The other way: somebody stores meanwhile, and mine takes its place.
  await fetch(draftPath(), { method: "PUT", headers: { "Content-Type": "application/jsonl", "If-Match": "*" }, body: WRITTEN });
  await write(mine, 2);
  await button("Store").click();
  await conflict.waitFor();
  await button("Keep mine").click();
  await becomes(() => fetch(draftPath()).then((r) => r.json()).then((found) => found.text), mine, "mine is stored");
  await conflict.waitFor({ state: "detached" });
  await page.getByTestId("undo").click();
  await becomes(draft, WRITTEN, "theirs is one step back");
  assert.deepEqual(unexpected(), []);
});

test("a schedule that is put in force meanwhile is told, and is what the draft is compared with", TEST, async () => {
  await open();
  const inForce = await draft();
  await area().fill(`${inForce}\n// mine\n`);
  await becomes(() => page.getByTestId("changes").textContent(), "No row differs.");
  const newer = inForce.replace('"filter":"B"', '"filter":"V"');
  await page.route("**/schedule/revisions?*", (route) => route.fulfill({ json: [2, 1].map((version) => ({ version, at_utc: "2026-11-27T02:01:33Z", author: "ana", rows: 10, bytes: 10, sha256: version === 2 ? "other" : "1" })) }));
  await page.route(`**/api/v1/telescopes/${ID}/schedule`, (route) => route.fulfill({ contentType: "application/jsonl", headers: { etag: '"other"' }, body: newer }));
  const key = `${ID}/observatory/schedule/state`;
  const state = (await bus.states())[key];
  await bus.put({ [key]: { ...state, revision: 7, sha256: "other" } });
  const told = page.getByTestId("other-in-force");
  await told.waitFor();
  await page.getByTestId("changes").locator(".del", { hasText: 'filter: "V"' }).waitFor();
  await page.locator('[data-testid="version-row"]', { hasText: "ana" }).filter({ hasText: "in force" }).waitFor();
  await becomes(() => page.getByTestId("in-force").textContent(), "version 2", "its number in the list, and not the count of its node");
  assert.equal(await draft(), `${inForce}\n// mine\n`);
  await told.getByRole("button", { name: "I have seen it" }).click();
  await told.waitFor({ state: "detached" });
  await bus.put({ [key]: state });
});

test("where no schedule is in force, the draft begins empty, and a template fills it", TEST, async () => {
  await begin();
  await bus.reset();
  await page.route(`**/api/v1/telescopes/${ID}/schedule`, (route) => route.fulfill({ status: 404, json: { detail: "there is none" } }));
  await page.goto(`${bus.url}/t/${ID}/schedule`);
  await settled(page);
  await button("Edit a draft").click();
  await becomes(draft, "");
  await page.locator('[data-testid="draft-line"] .tw-night').waitFor();
  await page.getByTestId("add-row").click();
  await page.getByTestId("templates").getByRole("button", { name: /^object/ }).click();
  await page.getByTestId("row-form").getByRole("button", { name: "Put it into the draft" }).click();
  const row = JSON.parse(await becomes(draft, (text) => text !== "", "a row"));
  // Half past two in the night, the next minute, for an hour; the filter is one of the wheel's.
  assert.match(row.start_time, /^2026-11-27 02:(29|3\d):00$/);
  assert.equal(Date.parse(`${row.end_time}Z`) - Date.parse(`${row.start_time}Z`), 3600e3);
  assert.deepEqual([row.device_name, row.action_type, row.action_value.filter], ["camera", "object", "B"]);
  await button("Activate …").click();
  await page.getByRole("dialog").getByLabel("Why").fill("the first night");
  await page.getByRole("dialog").getByRole("button", { name: "Activate", exact: true }).click();
  const [order] = await becomes(bus.orders, (all) => all.length > 0, "it is ordered");
  assert.deepEqual(Object.keys(order.do.put_schedule), ["text"], "in the place of whichever there is");
  assert.deepEqual(unexpected(), []);
});

test("a file is taken as the draft, and the draft as a file, with every comment", TEST, async () => {
  await open();
  await page.getByLabel("A file with a schedule").setInputFiles({ name: `${MARKUP}.jsonl`, mimeType: "application/jsonl", buffer: Buffer.from(WRITTEN) });
  await becomes(draft, WRITTEN);
  const [download] = await Promise.all([page.waitForEvent("download"), button("Download").click()]);
  assert.equal(download.suggestedFilename(), "demo-alpha-20261126.jsonl");
  assert.equal(readFileSync(await download.path(), "utf8"), WRITTEN);
  await page.getByLabel("A file with a schedule").setInputFiles({ name: "large.jsonl", mimeType: "application/jsonl", buffer: Buffer.alloc(1_000_001, 32) });
  await page.getByRole("alert").filter({ hasText: /large\.jsonl has 1000001 bytes/ }).waitFor();
  assert.equal(await draft(), WRITTEN);
  assert.deepEqual(unexpected(), []);
});

test("names that are markup, or very long, stay text, and the editor fits in every theme", TEST, async () => {
  await open({ on: phone, viewport: NARROW });
  const row = (object, at) => JSON.stringify({ device_name: MARKUP, action_type: "object", action_value: { object, ra: 24, dec: -45, exptime: MARKUP, [MARKUP]: { a: [MARKUP] } }, start_time: `2026-11-27 0${at}:00:00`, end_time: `2026-11-27 0${at + 1}:00:00`, [MARKUP]: MARKUP });
  await write(`// ${MARKUP}\n${row(MARKUP, 3)}\n${row("W".repeat(3000), 4)}\n{"__proto__": {"object": 1}, "action_type": {"tag": "img"}, "action_value": "x", "start_time": 7}`, 2);
  await page.route("**/schedule/validate", (route) => route.fulfill({ json: { valid: false, rows: 3, errors: 1, warnings: 1, findings: [{ severity: "error", check: MARKUP, line: 2, column: 4, field: MARKUP, what: MARKUP, right: "W".repeat(500), fix: { line: 2, column: 1, end_line: 2, end_column: 2, text: MARKUP.repeat(20) } }, { severity: "warning", check: "time", line: 99, column: 1, what: MARKUP }] } }));
  await area().press("End");
  await area().pressSequentially(" ");
  await page.getByTestId("findings").locator("li").nth(1).waitFor();
  for (const number of [1, 2]) {
    await bar(number).locator(".body").focus();
    await page.keyboard.press("ArrowRight");
    await page.locator('[data-testid="chosen"] .end', { hasText: `line ${number + 1}` }).waitFor();
    assert.equal(await tooWide(page), null);
  }
  await bar(1).locator(".b-err").waitFor();
  await page.getByTestId("findings").getByRole("button").first().click();
  await becomes(() => area().evaluate((one) => one.value.slice(0, one.selectionStart).split("\n").length), 2, "a finding leads to its line");
  assert.deepEqual(await looks(page, "editor"), []);
  await page.getByTestId("add-row").click();
  await page.getByTestId("templates").waitFor();
  assert.equal(await tooWide(page), null);
  await page.getByTestId("templates").getByRole("button", { name: /^object/ }).click();
  await becomes(() => page.getByTestId("row-form").getByLabel("Object", { exact: true }).inputValue(), (value) => value.startsWith("W"), "as text");
  assert.deepEqual(await page.evaluate(() => [window.taken, document.querySelectorAll("#app img[src=x], #app script").length]), [undefined, 0]);
  assert.deepEqual(unexpected(), []);
});

test("a value is changed where it stands, and rows are told apart as the observatory node does", TEST, async () => {
  await open();
  const found = await page.evaluate(async (text) => {
    const { difference, moved, rowsOf, timeLike, timeOf, withNew, withRow, without } = await import("/assets/rowtext.js");
    const changed = (raw, next) => { const row = rowsOf(raw)[0]; return withRow(raw, row, next(row.row)); };
    const [open, object] = rowsOf(text);
    const put = (raw, start) => withNew(text, raw, start).text.replace(text.slice(open.from, open.to), "A").replace(text.slice(object.from, object.to), "B");
    return {
      rows: rowsOf(text).map(({ line, lines, start, end }) => [line, lines, start, end - start]),
      added: changed('{"a":{},"b":1}', (row) => ({ ...row, a: { z: 1 }, c: "x" })), taken: changed('{"a": 1, "b": 2, "c": 3}', ({ b }) => ({ b })), nested: changed('{"a":{"b":{"c":1},"d":[1,{"e":"}"}]} }', (row) => ({ a: { ...row.a, d: [2] } })),
      times: ["2026-11-27T03:00:00.5Z", "2026-11-27 03:00", "20261127T030000Z", "27.11.2026 03:00:00", "2026/11/27 05:00:00 +0200", "2026-11-26 22:00:00 -05:00 ", "11.12.2026 03:00"].map((like) => [timeOf(like) - Date.UTC(2026, 10, 27, 3), timeLike(like, Date.UTC(2026, 10, 28))]),
      moved: moved(object, object.start, object.end + 60e3), first: put("N", open.start - 1), middle: put("N", open.start), last: put("N", object.start), removed: without(text, object), beside: without('{"a":1} {"b":2}', rowsOf('{"a":1} {"b":2}')[1]),
      broken: rowsOf('{"a": "x\n{"b": 2}\n]]{"c":\n  {"d": 4}').map(({ row }) => row), many: rowsOf('{"a":[{\n'.repeat(5000)).length,
      order: difference('{"a":1,"b":{"c":1,"d":2}}', '\n{"b": {"d":2,"c":1}, "a":1}\n').length, number: difference('{"a":1.0}', '{"a":1}').map(({ change }) => change),
      twins: difference('{"a":1}\n{"a":1}', '{"a":1}\n{"a":1}\n{"a":1}').map(({ change }) => change), other: difference('{"a":1}', '{"a":2}\n{"device_name":"x"}').map(({ change, fields }) => [change, ...fields]),
    };
  }, WRITTEN);
  const text = WRITTEN.split("\n");
  assert.deepEqual(found, {
    rows: [[2, 1, Date.UTC(2026, 10, 27, 0, 10), 7 * 3600e3 + 50 * 60e3], [5, 4, Date.UTC(2026, 10, 27, 3) + 500, 7199.5e3]],
    added: '{"a":{"z":1},"b":1,"c":"x"}', taken: '{"b": 2}', nested: '{"a":{"b":{"c":1},"d":[2]} }',
    times: [[500, "2026-11-28T00:00:00Z"], [0, "2026-11-28 00:00"], [null, "2026-11-28 00:00:00"], [0, "2026-11-28 00:00:00"], [0, "2026/11/28 02:00:00 +0200"], [0, "2026-11-27 19:00:00 -05:00"], [null, "2026-11-28 00:00:00"]].map(([ms, like]) => [ms ?? NaN, like]),
    moved: { device_name: "camera", action_type: "object", action_value: { object: "SN 2026x", ra: 24.35, dec: -45.68, exptime: 120, filter: "R" }, start_time: "2026-11-27T03:00:00.500Z", end_time: "2026-11-27T05:01:00Z" },
    first: `${text[0]}\nN\nA\n\n${text[3]}\nB\n// the end`, middle: `${text[0]}\nA\nN\n\n${text[3]}\nB\n// the end`, last: `${text[0]}\nA\n\n${text[3]}\nB\nN\n// the end`, removed: [...text.slice(0, 4), "// the end"].join("\n"), beside: '{"a":1} ',
    broken: [{ b: 2 }, { d: 4 }], many: 0, order: 0, number: ["changed"], twins: ["added"], other: [["changed", { field: "a", before: 1, after: 2 }], ["added"]],
  });
});

test("a finding whose fix is sure has a button that makes it: one step each, and nothing else of the text changes", TEST, async () => {
  await open();
  const twin = lines(WRITTEN)[0];
  const text = `${WRITTEN.replace('"exptime": 120.0,   "filter": "R"', '"object2": "🔭", "exptime": 120000.0,   "filter": "R🔭"')}\n${twin}\n`;
  // A place is a line and a character of it, of which the page's own texts may have two units.
  const place = (now, at) => { const before = now.slice(0, at).split("\n"); return [before.length, [...before[before.length - 1]].length + 1]; };
  const finding = (now, old, put) => {
    const at = now.lastIndexOf(old);
    const [[line, column], [end_line, end_column]] = [place(now, at), place(now, at + old.length)];
    return { severity: "error", check: "schema", line, column, what: "is wrong", fix: { line, column, end_line, end_column, text: put } };
  };
  let isHeld = false;
  await page.route("**/schedule/validate", (route) => {
    const now = route.request().postData();
    const wrong = [[', "object2": "🔭"', ""], ["120000.0", "86400"], ['"R🔭"', '"R"'], [twin, ""]].filter(([old]) => now.split(old).length > (old === twin ? 2 : 1));
    const findings = [...wrong.map(([old, put]) => finding(now, old, put)), { severity: "warning", check: "moon", line: 5, column: 1, what: "the Moon stands near" }];
    return isHeld ? undefined : route.fulfill({ json: { valid: !wrong.length, rows: 3, errors: wrong.length, warnings: 1, findings } });
  });
  await write(text, 3);
  const fix = page.getByTestId("fix");
  await becomes(() => fix.count(), 4, "the Moon has none");
  let now = text;
  for (const [name, old, put] of [['Use "R" in line 7', '"R🔭"', '"R"'], ["Use 86400 in line 7", "120000.0", "86400"], ["Remove in line 7", ', "object2": "🔭"', ""], ["Remove in line 10", `// the end\n${twin}\n`, "// the end\n"]]) {
    await button(name).click();
    now = now.replace(old, put);
    await becomes(draft, now, name);
  }
  assert.equal(now, `${WRITTEN.replace("120.0", "86400")}\n`);
  await becomes(() => fix.count(), 0, "all are made");
  await button("Undo: fixing line 10").click();
  await becomes(() => fix.count(), 1, "one step back");
  await becomes(async () => lines(await draft()).length, 3);
  // Findings of a text that is gone say nothing of the places of this one.
  isHeld = true;
  await area().press("End");
  await area().pressSequentially(" ");
  await becomes(() => fix.isDisabled(), true, "until it is looked at again");
  assert.deepEqual(unexpected(), []);
});

test("the dry run shows what the draft would do, and says when it is of an older text", TEST, async () => {
  await open();
  await button("Dry run").click();
  const run = page.getByTestId("dry-run");
  await run.locator("tr", { hasText: "5 object WASP-79" }).filter({ hasText: "20 of 20" }).waitFor();
  await area().press("End");
  await area().pressSequentially(" ");
  await run.locator(".end", { hasText: "before the last change" }).waitFor();
  assert.deepEqual(unexpected(), []);
});

test("a draft that somebody else has stored stays when another text is activated, and that replaces what was shown, whatever is in force meanwhile", TEST, async () => {
  await open();
  const inForce = await draft();
  const theirs = `${inForce}\n// of Bob, for tomorrow\n`;
  await button("Close the draft").click();
  await fetch(draftPath(), { method: "PUT", headers: { "Content-Type": "application/jsonl", "If-None-Match": "*" }, body: theirs });
  await button("Edit a draft").click();
  await becomes(draft, theirs, "what nobody has changed here is read again");
  await area().fill(`${inForce}\n// mine\n`);
  await bus.reset();
  await button("Activate …").click();
  const dialog = page.getByRole("dialog");
  await dialog.getByLabel("Why").fill("a clear night");
  const key = `${ID}/observatory/schedule/state`;
  const state = (await bus.states())[key];
  await page.route(`**/api/v1/telescopes/${ID}/schedule`, (route) => route.fulfill({ contentType: "application/jsonl", headers: { etag: '"other"' }, body: inForce }));
  await bus.put({ [key]: { ...state, revision: 2, sha256: "other" } });
  await page.getByTestId("other-in-force").waitFor({ state: "attached" });
  await dialog.getByRole("button", { name: "Activate", exact: true }).click();
  const [order] = await becomes(bus.orders, (all) => all.length > 0, "it is ordered");
  assert.equal(order.do.put_schedule.instead_of, state.sha256);
  await button("Edit a draft").waitFor();
  assert.equal(await (await fetch(draftPath(), { headers: { Accept: "application/jsonl" } })).text(), theirs);
  await bus.put({ [key]: state });
});

test("a schedule that cannot be read is not taken for none", TEST, async () => {
  await begin();
  await page.route(`**/api/v1/telescopes/${ID}/schedule`, (route) => route.fulfill({ status: 504, json: { detail: "demo/alpha: it has 3000000 bytes." } }));
  await page.goto(`${bus.url}/t/${ID}/schedule`);
  await settled(page);
  await button("Edit a draft").click();
  await page.getByText(/The schedule cannot be read.*3000000 bytes/s).waitFor();
  assert.equal(await area().count(), 0);
});

test("a file that is no UTF-8 is refused, and a dialog stays open when a text is marked beyond its edge", TEST, async () => {
  await open();
  const before = await draft();
  await page.getByLabel("A file with a schedule").setInputFiles({ name: "night.jsonl", mimeType: "text/plain", buffer: Buffer.from("// caf\u00e9\n", "latin1") });
  await page.getByText("night.jsonl is no text in UTF-8; save it as UTF-8, and upload it again.").waitFor();
  assert.equal(await draft(), before);
  await page.getByTestId("add-row").click();
  const box = await boxOf(page.locator("dialog h2").first());
  await page.mouse.move(box.x + 5, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(3, 3);
  await page.mouse.up();
  await becomes(() => page.locator("dialog").count(), 1);
  await page.mouse.click(3, 3);
  await page.locator("dialog").waitFor({ state: "detached" });
  assert.deepEqual(unexpected(), []);
});
