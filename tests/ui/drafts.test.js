// The draft of a schedule: nobody loses what was written, whoever else writes or activates meanwhile; versions of before, and files.
import { test } from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { TEST, becomes, boxOf, newPage, settled } from "./browser.js";
import { ID, MARKUP, WIDE, WRITTEN, area, begin, browser, bus, button, draft, draftPath, edit, lines, open, page, unexpected, write } from "./editor.js";

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
