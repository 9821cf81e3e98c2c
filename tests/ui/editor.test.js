// A row of a schedule by its form, made from the action's schema: it becomes a line of the draft, and a line becomes the form again.
import { test, before, after } from "node:test";
import assert from "node:assert/strict";
import { TEST, becomes, launch, newPage, problemsOf, settled, startRecorded } from "./browser.js";

let bus, browser, page, problems;

before(async () => {
  bus = await startRecorded();
  browser = await launch();
  page = await newPage(browser, { reducedMotion: "reduce", viewport: { width: 390, height: 844 } });
  problems = problemsOf(page);
  await page.goto(`${bus.url}/t/demo/alpha/schedule`);
  await settled(page);
  await page.getByRole("button", { name: "Edit a draft" }).click();
}, TEST);

after(async () => {
  await browser?.close();
  await bus?.end();
}, TEST);

const draft = () => page.getByLabel("Schedule, one row a line").inputValue();
const lines = (text) => text.split("\n").filter((line) => line.trim().startsWith("{"));

test("a row is added by its form, with numbers as numbers and nothing that was left empty", TEST, async () => {
  const before = await becomes(async () => lines(await draft()).length, (count) => count > 0, "the draft has the rows of the schedule");
  await page.locator('[data-testid="add-row"]').click();
  const form = page.locator('[data-testid="row-form"]');
  await form.getByLabel("Action").selectOption("object");
  await form.getByLabel("Object", { exact: true }).fill("TOI-700");
  await form.getByLabel("Exptime", { exact: true }).fill("30.5");
  await form.getByLabel("From, UTC").fill("2026-11-28 03:00:00");
  await form.getByLabel("Until, UTC").fill("2026-11-28 04:00:00");
  await form.getByRole("button", { name: "Put it into the draft" }).click();
  await form.waitFor({ state: "detached" });
  const after = await becomes(async () => lines(await draft()), (all) => all.length === before + 1, "one row more");
  const row = after.map((line) => JSON.parse(line)).find((one) => one.action_value?.object === "TOI-700");
  assert.deepEqual(row.action_value, { object: "TOI-700", exptime: 30.5 });
  assert.deepEqual([row.action_type, row.start_time, row.end_time], ["object", "2026-11-28 03:00:00", "2026-11-28 04:00:00"]);
});

test("the line of the cursor is changed by the form, and what the form does not have stays", TEST, async () => {
  const area = page.getByLabel("Schedule, one row a line");
  const text = await draft();
  const at = text.split("\n").findIndex((line) => line.includes("TOI-700"));
  const offset = text.split("\n").slice(0, at).join("\n").length + 3;
  await area.evaluate((one, position) => { one.focus(); one.setSelectionRange(position, position); }, offset);
  await area.press("ArrowRight");
  await page.locator('[data-testid="change-row"]', { hasText: `Change line ${at + 1}` }).click();
  const form = page.locator('[data-testid="row-form"]');
  await becomes(() => form.getByLabel("Exptime", { exact: true }).inputValue(), "30.5");
  await form.getByLabel("Exptime", { exact: true }).fill("60");
  await form.locator("summary").click();
  await form.getByLabel("N", { exact: true }).fill("12");
  await form.getByRole("button", { name: "Change the line" }).click();
  await form.waitFor({ state: "detached" });
  const now = (await becomes(draft, (changed) => changed !== text, "the line is changed")).split("\n");
  assert.equal(now.length, text.split("\n").length);
  assert.deepEqual(JSON.parse(now[at]).action_value, { object: "TOI-700", exptime: 60, n: 12 });
  // That there is no draft yet is answered as 404.
  assert.deepEqual(problems.filter((one) => !/404/.test(one)), []);
});
