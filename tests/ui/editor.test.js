// The editor of a schedule: rows by forms and templates, rows dragged over the night, and findings that are mended. Whatever is done to a row, the rest of the text stays
// as it was written. Drafts, versions and files are in drafts.test.js.
import { test } from "node:test";
import assert from "node:assert/strict";
import { TEST, becomes, boxOf, looks, newPage, problemsOf, tooWide } from "./browser.js";
import { MARKUP, WRITTEN, area, browser, button, draft, lines, open, page, problems, unexpected, write } from "./editor.js";

const NARROW = { width: 390, height: 844 };
const phone = await newPage(browser, { viewport: NARROW, hasTouch: true, isMobile: true });
problems.set(phone, problemsOf(phone));

const bar = (number) => page.locator(`[data-testid="draft-bar"][data-row="${number}"]`);

/** Pixels of an hour on the timeline. */
const hourPx = async () => {
  const line = page.getByTestId("draft-line");
  const [{ width }, [from, to]] = [await boxOf(line.locator("svg")), await line.evaluate(({ dataset }) => [Number(dataset.from), Number(dataset.to)])];
  return (width - (width < 560 ? 52 : 78)) / ((to - from) / 3600e3);
};

/** Begin and end of a row of a text, by its object. */
function timesOf(text, object) {
  const row = text.replaceAll(/^\s*\/\/.*$/gm, "").match(new RegExp(`"object":\\s*"${object}"[^]*?"start_time":\\s*"([^"]*)"[^]*?"end_time":\\s*"([^"]*)"`));
  return [row[1], row[2]];
}

test("a letter draws the row that it changes anew and no other, and the comparison follows", TEST, async () => {
  await open();
  await page.route("**/schedule/validate", (route) => route.fulfill({ json: { valid: true, rows: 60, errors: 0, warnings: 0, findings: [] } }));
  const text = Array.from({ length: 60 }, (_, n) => `{"device_name":"camera","action_type":"object","action_value":{"object":"T ${n}"},"start_time":"2026-11-27T0${2 + (n % 6)}:00:00Z","end_time":"2026-11-27T08:40:00Z"}`).join("\n");
  await write(text, 60);
  await area().evaluate((one, at) => { one.focus(); one.setSelectionRange(at, at); }, text.indexOf('0"', text.indexOf('"T 30"')));
  await area().press("ArrowRight");
  await page.locator('[data-testid="chosen"] .end', { hasText: "line 31" }).waitFor();
  // A bar that is drawn measures its name.
  await page.evaluate(() => {
    const { prototype } = CanvasRenderingContext2D;
    const { measureText } = prototype;
    const measured = new Set();
    prototype.measureText = function noted(name) { measured.add(name); return measureText.call(this, name); };
    Object.assign(window, { measured });
  });
  await area().pressSequentially("x");
  await bar(31).locator("title", { hasText: "T 30x" }).waitFor({ state: "attached" });
  assert.deepEqual(await page.evaluate(() => [...window.measured]), ["T 30x"]);
  await page.getByTestId("changes").locator(".add", { hasText: "object T 30x" }).waitFor();
  assert.deepEqual(unexpected(), []);
});

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
      ends: rowsOf('{"a": 1}  \n{"b": "}"} {"c": 3}').map(({ from, to, line }) => [from, to, line]),
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
    ends: [[0, 8, 1], [11, 21, 2], [22, 30, 2]],
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
