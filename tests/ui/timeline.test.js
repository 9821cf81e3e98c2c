// Looking around in time: the timeline of the night and the charts are dragged and zoomed by mouse, touch and keys, and any moment leads to its log.
import { test } from "node:test";
import assert from "node:assert/strict";
import { network } from "./recorded/network.js";
import { TEST, addressOf, becomes, boxOf, fresh, newPage, problemsOf, settled, startRecorded, withBrowser } from "./browser.js";

const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true };

const [bus, browser] = await withBrowser(startRecorded());
await network(bus);
const page = await newPage(browser);
const problems = problemsOf(page);

async function open(address) {
  await fresh(page, { viewport: { width: 1280, height: 1000 }, problems });
  await page.goto(bus.url + address);
  await settled(page);
}

/** The part of the time that is shown, ms. */
const shown = (part) => part.evaluate(({ dataset }) => [Number(dataset.from), Number(dataset.to)]);
const length = ([from, to]) => to - from;

/** Waits until the part of the time meets a condition, and gives it. */
const until = (part, met, told) => becomes(() => shown(part), met, told);

for (const [what, address, selector] of [["the timeline of the night", "/t/demo/alpha", '[data-testid="timeline"]'], ["a chart", "/t/demo/alpha/weather", '[data-testid="chart"]']]) {
  test(`${what} is zoomed and dragged by keys, buttons and the mouse`, TEST, async () => {
    await open(address);
    const part = page.locator(selector).first();
    await part.scrollIntoViewIfNeeded();
    const look = page.locator(".look", { has: part }).or(part).first();
    const whole = await shown(part);
    // A chart that is read anew meanwhile is longer or shorter by what its answer took.
    const isWhole = (now) => length(now) > 0.99 * length(whole);
    const tools = look.locator(".time-tools");
    await look.focus();
    await page.keyboard.press("+");
    const near = await until(part, (now) => length(now) < 0.8 * length(whole), "+ shows less");
    await page.keyboard.press("Shift+ArrowLeft");
    const earlier = await until(part, (now) => now[0] < near[0], "Shift and an arrow move");
    assert.ok(Math.abs(length(earlier) - length(near)) < 5);
    await page.keyboard.press("-");
    await page.keyboard.press("-");
    await until(part, (now) => isWhole(now), "- shows all again");
    await tools.getByRole("button", { name: "Show less time" }).click();
    const zoomed = await until(part, (now) => length(now) < 0.8 * length(whole), "the button shows less");

    const spot = part.locator("canvas, svg").first();
    await spot.scrollIntoViewIfNeeded();
    const box = await boxOf(spot);
    const y = box.y + box.height / 2;
    await page.mouse.move(box.x + box.width / 2, y);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 2 + 120, y, { steps: 4 });
    await page.mouse.up();
    const dragged = await until(part, (now) => now[0] < zoomed[0], "dragging to the right shows what was earlier");
    await page.mouse.wheel(0, -300);
    await until(part, (now) => length(now) < length(dragged), "the wheel zooms what has the focus");
    await tools.getByRole("button", { name: "All" }).click();
    await until(part, (now) => isWhole(now), "all again");
    assert.deepEqual(problems, []);
  });

  test(`from a moment of ${what} to the log of that minute`, TEST, async () => {
    await open(address);
    const part = page.locator(selector).first();
    const look = page.locator(".look", { has: part }).or(part).first();
    const spot = part.locator("canvas, svg").first();
    await spot.scrollIntoViewIfNeeded();
    const box = await boxOf(spot);
    await page.mouse.click(box.x + box.width * 0.4, box.y + box.height / 2);
    const link = look.locator('[data-testid="log-here"]');
    const at = Date.parse(new URL(await link.evaluate((one) => one.href)).searchParams.get("at"));
    const [from, to] = await shown(part);
    assert.ok(at > from && at < to, `${at} in ${from} to ${to}`);
    await link.click();
    await becomes(() => addressOf(page), ({ pathname, at: shown }) => pathname === "/t/demo/alpha/log" && Date.parse(shown) === at, "the log of that moment");
    await page.locator('[data-testid="lines"], .empty').first().waitFor();
  });
}

test("two fingers zoom the timeline, one drags it, and a touch chooses a moment", TEST, async () => {
  // A context has touch or has not.
  const phone = await newPage(browser, PHONE);
  const found = problemsOf(phone);
  await phone.goto(`${bus.url}/t/demo/alpha`);
  await settled(phone);
  const part = phone.locator('[data-testid="timeline"]');
  // What comes later than the page moves it no more, and no bar at the edge covers it.
  await part.locator(".b-next, .b-run").first().waitFor();
  await phone.waitForLoadState("networkidle");
  await part.evaluate((one) => one.scrollIntoView({ block: "center" }));
  const before = await shown(part);
  assert.ok(length(before) <= 7.1 * 3600e3, "a phone begins with the hours around now");
  const { x, y, width, height } = await boxOf(part);
  const client = await phone.context().newCDPSession(phone);
  const touch = (type, ...points) => client.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([px, py], id) => ({ x: px, y: py, id })) });
  const [left, right, middle] = [x + width * 0.45, x + width * 0.6, y + height / 3];
  await touch("touchStart", [left, middle], [right, middle]);
  await touch("touchMove", [left - 30, middle], [right + 40, middle]);
  await touch("touchMove", [left - 60, middle], [right + 80, middle]);
  await touch("touchEnd");
  const near = await until(part, (now) => length(now) < 0.7 * length(before), "two fingers apart show less time");
  await touch("touchStart", [left, middle]);
  for (const step of [20, 50, 90]) await touch("touchMove", [left + step, middle]);
  await touch("touchEnd");
  await until(part, (now) => now[0] < near[0], "one finger to the right shows what was earlier");
  await phone.touchscreen.tap(x + width / 2, middle);
  await phone.locator('[data-testid="log-here"]').waitFor();
  assert.deepEqual(found, []);
  await phone.close();
});

test("the night of all telescopes has a line for each, worst first, and a name leads to its telescope", TEST, async () => {
  await open("/");
  await page.locator('[data-testid="nights"]').scrollIntoViewIfNeeded();
  await page.locator('[data-testid="night-line"]').nth(3).waitFor();
  const of = (name) => page.locator(`[data-testid="${name}"]`).evaluateAll((all) => all.map((one) => one.dataset.of));
  await becomes(async () => (await of("night-line"))[0], "ridge/delta", "first is what needs somebody");
  await becomes(async () => [await of("night-line"), await of("row")], ([lines, rows]) => String(lines) === String(rows), "the table has the same order");
  await page.locator('[data-testid="night-line"] .b-done, [data-testid="night-line"] .b-run').first().waitFor();
  await page.locator('[data-testid="nights"] .names a').first().click();
  await page.locator("h1", { hasText: "delta" }).waitFor();
});

test("the header counts what calls for somebody, and not what somebody has acknowledged", TEST, async () => {
  await open("/");
  await page.locator('[data-testid="row"]').nth(3).waitFor();
  const count = (word) => page.locator(`header.top [data-testid="count-${word}"]`);
  await count("critical").filter({ hasText: "1" }).waitFor();
  await becomes(() => count("high").count(), 0, "the acknowledged one of delta");
});

test("a closed telescope tells each reason and when it can clear, and what comes then", TEST, async () => {
  await open("/t/ridge/gamma");
  const reasons = page.locator('[data-testid="now"] [data-testid="reasons"]');
  await reasons.locator("li", { hasText: /wind speed.*17\.3 m\/s is above 15 m\/s.*can clear \d\d:\d\d:\d\d, in 2\d min/ }).waitFor();
  await page.locator('[data-testid="now"]', { hasText: /Waits for.*Wind speed\. Then object WASP-18 goes on/ }).waitFor();
});

test("the step that is under way counts down, and tells by how much it is late", TEST, async () => {
  const state = "demo/beta/observatory/night/state";
  const night = (await bus.states())[state];
  const due = (utc) => bus.put({ [state]: { ...night, actions: [{ ...night.actions[0], expected_by_utc: utc }] } });
  await due("2026-11-27T09:00:00.000000Z");
  await open("/t/demo/beta");
  const expected = page.locator('[data-testid="now"] [data-testid="expected"]');
  await expected.filter({ hasText: /should end by 09:00:00, in 6 h/ }).waitFor();
  await due("2026-11-27T02:20:00.000000Z");
  await expected.filter({ hasText: /should have ended \d+ min.* ago/ }).waitFor();
  assert.match(await expected.getAttribute("class"), /ink-p2/);
  await bus.put({ [state]: night });
  await becomes(() => expected.count(), (count) => count === 0, "a step without such a time");
});
