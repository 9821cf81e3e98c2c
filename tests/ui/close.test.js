// Closing is two touches away on every page of a telescope, and sends one order; a hold that is let go sends none.
import { test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { EVERY, TEST, becomes, namesOf, newPage, settled, startRecorded, withBrowser } from "./browser.js";

const [bus, browser] = await withBrowser(startRecorded());
const page = await newPage(browser);
await page.goto(bus.url);
await page.locator('[data-telescope="demo/alpha"][data-quality="fresh"]').waitFor();

beforeEach(() => bus.reset());

/** Waits until the telescope was asked something, and gives all orders; one that was asked again, since its answer took long, is one. */
async function orders() {
  const asked = await becomes(bus.orders, (all) => all.length, "the telescope is asked something");
  return [...new Map(asked.map((order) => [order.id, order])).values()];
}

test("on every page of a telescope two touches close it, on a phone and on a wide screen", TEST, async (context) => {
  for (const name of (await namesOf(page)).telescope) {
    await context.test(name, TEST, async () => {
      await page.goto(`${bus.url}/t/demo/alpha${name === "now" ? "" : `/${name}`}`);
      await settled(page);
      // The phone first: what is told of its order stands at the foot of the page, where a phone has Close.
      for (const [times, width, height] of [[1, 390, 844], ...(EVERY || name === "now" ? [[2, 1280, 900]] : [])]) {
        await page.setViewportSize({ width, height });
        await bus.reset();
        const button = page.locator('[data-testid="close"]:visible').first();
        await becomes(() => button.boundingBox(), (box) => box && box.y >= 0 && box.y + box.height <= height, "it is in view without scrolling");
        await button.click();
        await page.locator('[data-testid="close-now"]').click();
        const asked = await orders();
        assert.deepEqual(asked.map((order) => [order.key, order.do]), [["demo/alpha/observatory/order", "close"]]);
        await becomes(() => page.getByText("not yet verified closed").count(), times, "it tells of each order");
      }
    });
  }
});

test("the dialog has its focus on Close, Enter closes, and Escape sends nothing and gives the focus back", TEST, async () => {
  await page.setViewportSize({ width: 1280, height: 900 });
  await page.goto(`${bus.url}/t/demo/alpha`);
  await settled(page);
  const button = page.locator('.scope [data-testid="close"]');
  await button.focus();
  await page.keyboard.press("Enter");
  await page.locator('[data-testid="close-now"]:focus').waitFor();
  await page.keyboard.press("Escape");
  await page.locator("dialog").waitFor({ state: "detached" });
  await becomes(() => button.evaluate((one) => one === document.activeElement), true, "the focus is where it was");
  await page.keyboard.press("Enter");
  await page.locator('[data-testid="close-now"]:focus').waitFor();
  await page.keyboard.press("Enter");
  assert.deepEqual((await orders()).map((order) => order.do), ["close"], "one order, of the second time");
});

test("a row of tonight is done without, and a finished one runs again, by orders that name the row and its schedule", TEST, async () => {
  const { sha256 } = (await bus.states())["demo/alpha/observatory/schedule/state"];
  for (const [name, about, wanted] of [["Skip row 5", "Skip row 5, object WASP-79?", { skip: { row: 4, of: sha256 } }], ["Repeat row 2", "Repeat row 2, open?", { repeat: { row: 1, of: sha256 } }]]) {
    await bus.reset();
    await page.goto(`${bus.url}/t/demo/alpha/schedule`);
    await settled(page);
    await page.getByRole("button", { name, exact: true }).click();
    await page.locator("dialog h2", { hasText: about }).waitFor();
    assert.equal(await page.locator("dialog").getByLabel(/number|SHA/i).count(), 0, "what is known is not asked");
    await page.locator("dialog input[name=reason]").fill("clouds in the south");
    await page.locator("dialog .hold").dispatchEvent("pointerdown");
    await page.locator("dialog").waitFor({ state: "detached" });
    const [order] = await orders();
    assert.deepEqual([order.do, order.reason], [wanted, "clouds in the south"]);
  }
  // What has not begun and what is over are not offered the other.
  assert.equal(await page.getByRole("button", { name: "Repeat row 5", exact: true }).count(), 0);
  assert.equal(await page.getByRole("button", { name: "Skip row 2", exact: true }).count(), 0);
});

test("an order towards the sky is held to its end; let go before, it sends nothing", TEST, async () => {
  await page.clock.install();
  await page.goto(`${bus.url}/t/demo/alpha/controls`);
  await settled(page);
  await page.locator('[data-order="start"] button').click();
  const hold = page.locator("dialog .hold");
  await page.locator("dialog input[name=reason]").fill("the sky is clear");
  // From here the page's time goes on only when it is told to.
  const pause = async () => page.clock.pauseAt((await page.evaluate(() => Date.now())) + 2000).then(() => true, (error) => error);
  await becomes(pause, true, "the page's clock stands, unless 2 s passed meanwhile");
  await hold.dispatchEvent("pointerdown");
  await page.clock.runFor(1400);
  await hold.dispatchEvent("pointerup");
  await page.clock.runFor(5000);
  await becomes(() => page.locator("dialog").count(), 1, "the dialog is still open");
  assert.deepEqual(await bus.orders(), []);
  await hold.dispatchEvent("pointerdown");
  await page.clock.runFor(1600);
  await page.locator("dialog").waitFor({ state: "detached" });
  assert.equal((await orders()).length, 1);
});
