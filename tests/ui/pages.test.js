// Every page of the table of pages, on a recorded bus: it opens in three themes and two widths, breaks no rule of the browser, asks nobody
// else, fits a phone, and can be used by those who do not see well.
import { test } from "node:test";
import assert from "node:assert/strict";
import { network } from "./recorded/network.js";
import { LOOKS, TEST, becomes, chooseTheme, everyAddress, follow, looks, newPage, problemsOf, settled, startRecorded, withBrowser } from "./browser.js";

const [bus, browser] = await withBrowser(startRecorded());
await network(bus);
const page = await newPage(browser);
const problems = problemsOf(page);
await page.goto(bus.url);
await page.locator('[data-telescope="demo/alpha"][data-quality="fresh"]').waitFor();
await page.locator('[data-telescope="ridge/delta"][data-level="p1"]').waitFor();

const choose = (theme) => chooseTheme(page, theme);

test("every page opens in three themes at two widths, fits, and has no serious finding of axe-core", TEST, async (context) => {
  const found = [];
  for (const address of await everyAddress(page)) {
    await context.test(address, TEST, async () => {
      await page.setViewportSize({ width: 1280, height: 900 });
      await page.goto(bus.url + address);
      await settled(page);
      assert.equal(await page.locator("[data-broken]").count(), 0, "a part cannot be drawn");
      await becomes(() => page.locator("main h1").count(), 1, "titles");
      found.push(...(await looks(page, address, LOOKS)));
    });
  }
  assert.deepEqual(found, []);
  assert.deepEqual(problems, []);
});

test("a text that cannot be read in one theme is found there, beside others that can", TEST, async () => {
  await follow(page, `${bus.url}/t/demo/alpha`);
  await page.evaluate(() => {
    const text = document.createElement("p");
    text.textContent = "as pale as paper";
    text.style.color = "#c8ccd0";
    document.querySelector("main").append(text);
  });
  const found = await looks(page, "now", LOOKS);
  assert.deepEqual(found.map((one) => one.split(">")[0]), LOOKS.filter(([, theme]) => theme === "light").map(([{ width }]) => `now ${width} light: color-contrast: <p style="color: rgb(200, 204, 208);"`));
});

test("a theme is kept, and the key t goes through all", TEST, async () => {
  await page.goto(`${bus.url}/t/demo/alpha`);
  await settled(page);
  const theme = () => page.evaluate(() => document.documentElement.dataset.theme);
  await choose("night");
  await page.reload();
  await settled(page);
  await becomes(theme, "night");
  for (const next of ["light", "dark", "night"]) {
    await page.keyboard.press("t");
    await becomes(theme, next);
  }
});

test("in the night theme no part of the page has green or blue", TEST, async () => {
  for (const address of ["/", "/t/demo/alpha", "/t/demo/alpha/weather", "/t/demo/alpha/guiding"]) {
    await follow(page, bus.url + address);
    await choose("night");
    const shot = await page.screenshot();
    const other = await page.evaluate(async (data) => {
      const image = await createImageBitmap(new Blob([Uint8Array.from(atob(data), (c) => c.charCodeAt(0))]));
      const canvas = new OffscreenCanvas(image.width, image.height);
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      const { data: pixels } = context.getImageData(0, 0, image.width, image.height);
      let count = 0;
      for (let i = 0; i < pixels.length; i += 4) count += pixels[i + 1] > 12 || pixels[i + 2] > 12;
      return count;
    }, shot.toString("base64"));
    assert.equal(other, 0, address);
  }
});

test("the key / goes to the filter, and a chart is read by arrow keys", TEST, async () => {
  await page.goto(bus.url);
  await settled(page);
  await page.keyboard.press("/");
  await page.locator("input[type=search]:focus").waitFor();
  await page.keyboard.type("no such telescope");
  await page.waitForFunction(() => document.querySelectorAll('[data-testid="row"]').length === 0);
  await page.goto(`${bus.url}/t/demo/alpha/weather`);
  await settled(page);
  const chart = page.locator('[data-testid="chart"]').first();
  await chart.focus();
  const reading = () => chart.locator(".read").first().textContent();
  for (let i = 0; i < 3; i += 1) {
    const before = await reading();
    await page.keyboard.press("ArrowLeft");
    await page.waitForFunction(([element, text]) => element.querySelector(".read").textContent !== text, [await chart.elementHandle(), before]);
  }
  await becomes(reading, (text) => /at \d\d:\d\d:\d\d/.test(text), "the values are those at the cursor");
});
