// A machine that slept: its browser's monotonic clock stood still meanwhile, and all the same nothing of before is shown as the state now.
import { test, after } from "node:test";
import assert from "node:assert/strict";
import http from "node:http";
import { TEST, becomes, newPage, settled, startRecorded, withBrowser } from "./browser.js";

const HOUR_MS = 3600e3;
/** A camera that is asked each ten minutes: what it was asked, and what it has not answered yet. */
const camera = { asked: 0, gives: true, waiting: [] };
const answer = (response) => response.writeHead(200, { "content-type": "image/svg+xml" }).end('<svg xmlns="http://www.w3.org/2000/svg" width="64" height="64"><rect width="64" height="64" fill="#357"/></svg>');
const cameras = http.createServer((_, response) => {
  camera.asked += 1;
  if (camera.gives) answer(response);
  else camera.waiting.push(response);
});
await new Promise((resolve) => { cameras.listen(0, "127.0.0.1", resolve); });
after(() => {
  cameras.closeAllConnections();
  cameras.close();
});

const [bus, browser] = await withBrowser(startRecorded({ web: `[[web.webcam]]\nname = "Dome"\nurl = "http://127.0.0.1:${/** @type {any} */ (cameras.address()).port}/dome"\nperiod_s = 600\n` }));
const page = await newPage(browser);
// Of a sleep the page sees that the wall clock jumps, and that it is looked at again.
await page.addInitScript(() => {
  const { now } = Date;
  let ahead = 0;
  Date.now = () => now() + ahead;
  window.sleeps = (ms) => { ahead += ms; document.dispatchEvent(new Event("visibilitychange")); };
});
/** Sockets to a server that takes them and says nothing, while it is away. */
const held = [];
let isAway = false;
await page.routeWebSocket(/\/api\/v1\/ws/, (socket) => {
  if (isAway) held.push(socket);
  else socket.connectToServer();
});

test("after hours of sleep all is old at once, and everything is asked anew", TEST, async () => {
  await page.goto(`${bus.url}/t/demo/alpha`);
  await settled(page);
  const webcam = page.locator('[data-webcam="Dome"]');
  await webcam.scrollIntoViewIfNeeded();
  await page.locator('[data-webcam="Dome"][data-quality="fresh"] img').waitFor();
  await page.locator('[data-testid="device"][data-quality="fresh"]').first().waitFor();
  const { asked } = camera;
  camera.gives = false;
  isAway = true;
  const reads = page.waitForRequest(/\/frames\?image_type=light/);
  const at = await page.evaluate(async (ms) => {
    const { link } = await import("/assets/store.js");
    window.sleeps(ms);
    return link.peek();
  }, 4 * HOUR_MS);
  assert.equal(at, "lost", "in the same moment, before anything was received");
  await reads;
  await becomes(() => camera.asked > asked, true, "the camera is asked before its ten minutes are over");
  await page.locator('body[data-link="lost"]').waitFor();
  await becomes(() => page.locator('[data-quality="fresh"], [data-safety="safe"], [data-posture="open"]').evaluateAll((all) => all.map((one) => one.outerHTML.slice(0, 200))), []);
  await page.locator('[data-webcam="Dome"][data-quality="lost"]').waitFor();
  await becomes(async () => Number(await webcam.locator(".age").first().getAttribute("data-age-s")), (age) => age >= 4 * 3600, "its age counts the sleep");

  isAway = false;
  camera.gives = true;
  for (const socket of held.splice(0)) socket.close();
  camera.waiting.splice(0).forEach(answer);
  await page.locator('body[data-link="live"]').waitFor();
  await page.locator('[data-testid="device"][data-quality="fresh"]').first().waitFor();
  await page.locator('[data-webcam="Dome"][data-quality="fresh"] img').waitFor();
});

test("only a jump of the wall clock forward is sleep", TEST, async () => {
  const steps = await page.evaluate(async (hour) => {
    const { elapsed, sleptMs } = await import("/assets/elapsed.js");
    return [-3 * hour, 1500, 3 * hour].map((ms) => {
      const [slept, before] = [sleptMs(), elapsed()];
      window.sleeps(ms);
      return [sleptMs() - slept, elapsed() - before].map((step) => Math.round(step / hour));
    });
  }, HOUR_MS);
  assert.deepEqual(steps, [[0, 0], [0, 0], [3, 3]]);
});
