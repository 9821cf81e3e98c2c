// The page without its server: it opens, shows the last picture with everything marked as old, and goes on by itself when the server is back.
import { test } from "node:test";
import assert from "node:assert/strict";
import { TEST, becomes, newPage, settled, startRecorded, withBrowser } from "./browser.js";

const [bus, browser] = await withBrowser(startRecorded());
const page = await newPage(browser, { serviceWorkers: "allow" });

const ALPHA = '[data-telescope="demo/alpha"]';

test("the page opens without its server, shows the last picture as old, and goes on when the server is back", TEST, async () => {
  await page.goto(`${bus.url}/t/demo/alpha`);
  await settled(page);
  await page.locator('[data-testid="device"]').first().waitFor();
  await page.goto(bus.url);
  await page.locator(`${ALPHA}[data-quality="fresh"] img`).waitFor();
  await page.evaluate(() => navigator.serviceWorker.ready.then(() => true));
  // A picture of both pages, and the image of the telescope by the service worker.
  await page.locator('[data-testid="rail-telescope"]').click();
  await page.locator('[data-testid="device"]').first().waitFor();
  const isKept = () => page.evaluate(async () => {
    const found = await caches.match("/picture");
    const stored = await (await caches.open("picture")).keys();
    return Boolean(found) && (await found.text()).includes('"tel/demo/alpha"') && stored.some((one) => one.url.includes("image.jpg"));
  });
  await page.reload();
  await page.locator('[data-testid="device"]').first().waitFor();
  await becomes(isKept, true, "a picture is kept");
  const devices = await page.locator('[data-testid="device"]').count();

  await bus.stop();
  await page.goto(bus.url);
  await page.locator('body[data-link="lost"] [data-testid="link-lost"]', { hasText: /No link to the server since .*\d\d:\d\d:\d\d/ }).waitFor();
  const tile = page.locator(`[data-testid="tile"]${ALPHA}`);
  await tile.waitFor();
  await becomes(() => tile.evaluate(({ dataset }) => [dataset.quality !== "fresh", dataset.safety, dataset.posture]), [true, "unknown", "unknown"], "nothing old is shown as the state now");
  await tile.locator("img").waitFor();
  const fresh = () => page.locator('[data-quality="fresh"], [data-safety="safe"], [data-posture="open"]').evaluateAll((all) => all.map((one) => one.outerHTML.slice(0, 200)));
  await becomes(fresh, []);

  // An address that was not the one that is kept: the same page.
  await page.goto(`${bus.url}/t/demo/alpha`);
  await page.locator('body[data-link="lost"]').waitFor();
  await page.locator('[data-testid="device"]').first().waitFor();
  await becomes(() => page.locator('[data-testid="device"]').count(), devices, "the devices of the last picture");
  await becomes(fresh, []);

  await bus.again();
  await page.locator('body[data-link="live"]').waitFor();
  await page.locator('[data-testid="device"][data-quality="fresh"]').first().waitFor();
  await page.locator('[data-testid="link-lost"]').waitFor({ state: "detached" });
});

test("the manifest lets a phone install the page", TEST, async () => {
  const manifest = await (await fetch(`${bus.url}/assets/manifest.webmanifest`)).json();
  assert.deepEqual([manifest.start_url, manifest.scope, manifest.display], ["/", "/", "standalone"]);
  for (const icon of manifest.icons) assert.equal((await fetch(bus.url + icon.src)).status, 200);
});
