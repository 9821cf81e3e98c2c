// The page in Debian's Chromium while a demo runs: telescopes, ages that move, an image, and no console error.
import { test, before, after } from "node:test";
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { binary, comesUp, end, launch } from "../browser.js";

let demo, browser, page, port, folder;
let output = "";
const problems = [];

// below the range from which the kernel gives ports to whoever connects
const freePort = () =>
  new Promise((resolve) => {
    const port = 20_000 + Math.floor(Math.random() * 12_000);
    const server = createServer()
      .listen(port, "127.0.0.1", () => server.close(() => resolve(port)))
      .once("error", () => resolve(freePort()));
  });

before(async () => {
  port = await freePort();
  folder = mkdtempSync(join(tmpdir(), "starmesh-ui-"));
  // a proxy that is not there: hardware, frames and the simulator's clock are never asked through one
  const proxy = "http://127.0.0.1:9";
  const env = { ...process.env, http_proxy: proxy, HTTP_PROXY: proxy, https_proxy: proxy, all_proxy: proxy, ALL_PROXY: proxy };
  demo = spawn(binary, ["demo", "--speed", "120", "--port", String(port), "--keep", join(folder, "demo")], { env });
  demo.stdout.on("data", (data) => (output += data));
  demo.stderr.on("data", (data) => (output += data));
  await comesUp(demo, () => `http://127.0.0.1:${port}`, () => `:\n${output}`);
  browser = await launch();
  page = await browser.newPage({ viewport: { width: 1280, height: 900 } });
  page.on("console", (message) => message.type() === "error" && problems.push(message.text()));
  page.on("pageerror", (error) => problems.push(String(error)));
  page.on("requestfailed", (request) => problems.push(`${request.url()} ${request.failure()?.errorText}`));
}, { timeout: 120_000 });

after(async () => {
  await browser?.close();
  await end(demo, "SIGINT");
  if (process.env.KEEP_UI) console.log(output);
  rmSync(folder, { recursive: true, force: true });
}, { timeout: 60_000 });

test("the overview shows the telescope with a safety word and a posture", { timeout: 60_000 }, async () => {
  await page.goto(`http://127.0.0.1:${port}/`);
  const tile = page.locator('[data-testid="tile"]').first();
  await tile.waitFor({ timeout: 30_000 });
  await page.waitForFunction(() => /^(un)?safe$/.test(document.querySelector('[data-testid="tile"]')?.dataset.safety ?? ""), null,
    { timeout: 30_000 });
  assert.match(await tile.getAttribute("data-posture"), /closed|open|opening|closing|unknown/);
  assert.match(await tile.textContent(), /safe/i, "the safety word is there to read");
  assert.match(await tile.textContent(), /simul/i, "a simulated telescope says so");
});

test("the telescope page shows each device with an age that moves", { timeout: 60_000 }, async () => {
  await page.locator('[data-testid="rail-telescope"]').first().click();
  await page.locator('[data-testid="device"]').nth(9).waitFor({ timeout: 30_000 });
  assert.equal(await page.locator('[data-testid="device"]').count(), 10, "all ten devices");
  const ages = () => page.locator('[data-testid="device"] [data-age-s]').allTextContents();
  const first = await ages();
  assert.ok(first.length >= 10);
  await page.waitForFunction((before) => {
    const now = [...document.querySelectorAll('[data-testid="device"] [data-age-s]')].map((e) => e.textContent);
    return now.join() !== before;
  }, first.join(), { timeout: 15_000 });
});

test("the newest frame is shown as an image", { timeout: 150_000 }, async () => {
  await page.locator("img[data-frame]").first().waitFor({ timeout: 120_000 });
  await page.waitForFunction(() => document.querySelector("img[data-frame]")?.naturalWidth > 100, null, { timeout: 30_000 });
  const frame = await page.locator("img[data-frame]").first().getAttribute("data-frame");
  assert.ok(frame.length > 10, frame);
});

test("the log tells the night", { timeout: 60_000 }, async () => {
  await page.locator(".tabs a", { hasText: "Log" }).click();
  await page.waitForFunction(() => document.querySelectorAll("ul.log > li").length > 5, null, { timeout: 30_000 });
});

test("when the node dies the page says so", { timeout: 60_000 }, async () => {
  assert.deepEqual(problems, [], "no console error until here");
  demo.kill("SIGINT");
  await page.locator('[data-testid="link-lost"]').waitFor({ timeout: 30_000 });
});
