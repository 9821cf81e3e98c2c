// How soon the page shows something: from the address to the first telescope, and from a payload on the bus to the changed text.
//
// A release build of the web node on the recorded bus, Debian's Chromium on the same two cores: `node tests/bench/pages.js`; needs what
// `scripts/setup test` installs. See README.md beside this file.
import { join } from "node:path";

const root = join(import.meta.dirname, "../..");
process.env.STARMESH_BIN ??= join(root, "target/release/starmesh");
const { launch, newPage, settled, startRecorded } = await import("../ui/browser.js");

const LOADS = Number(process.env.LOADS ?? 20);
const MARKS = Number(process.env.MARKS ?? 60);

const sorted = (values) => [...values].sort((a, b) => a - b);
const at = (values, share) => sorted(values)[Math.min(values.length - 1, Math.floor(share * values.length))];
const words = (values) => `median ${at(values, 0.5).toFixed(0)}, p95 ${at(values, 0.95).toFixed(0)} of ${values.length}`;

/** From the beginning of the navigation to the first frame in which the page shows a telescope, ms, with an empty cache. */
async function firstTelescope(browser, url) {
  const context = await browser.newContext({ serviceWorkers: "block", viewport: { width: 390, height: 844 } });
  const page = await context.newPage();
  await page.addInitScript(() => {
    const look = () => (document.querySelector('main [href="/t/demo/alpha"]') ? requestAnimationFrame(() => { window.shownAt = performance.now(); }) : requestAnimationFrame(look));
    look();
  });
  await page.goto(url);
  const took = await page.waitForFunction(() => window.shownAt).then((handle) => handle.jsonValue());
  await context.close();
  return took;
}

/** From handing a payload to the bus to the frame in which the page has its text, ms. */
async function eventToPixel(page, bus, publish) {
  const took = [];
  for (let n = 0; n < MARKS; n += 1) {
    const mark = `mark-${Math.random().toString(36).slice(2, 10)}`;
    const shown = page.evaluate((text) => new Promise((resolve) => {
      const look = () => (document.querySelector("main").textContent.includes(text) ? requestAnimationFrame(() => resolve(Date.now())) : requestAnimationFrame(look));
      look();
    }), mark);
    const put = Date.now();
    // the recording goes on with it
    await bus.put(publish(mark));
    await bus.now(publish(mark));
    took.push((await shown) - put);
    // not in step with the recording's beat
    await page.waitForTimeout(50 + (97 * n) % 400);
  }
  return took;
}

const bus = await startRecorded();
const browser = await launch();
const rows = [];
try {
  const loads = [];
  for (let n = 0; n < LOADS; n += 1) loads.push(await firstTelescope(browser, `${bus.url}/`));
  rows.push(["address to the first telescope, phone, empty cache, ms", words(loads), "< 500"]);

  const page = await newPage(browser, { viewport: { width: 1280, height: 900 } });
  const states = await bus.states();
  const night = states["demo/alpha/observatory/night/state"];
  await page.goto(`${bus.url}/t/demo/alpha`);
  await settled(page);
  rows.push(["a step of the telescope on the bus to its text on the page, ms", words(await eventToPixel(page, bus, (mark) => ({ "demo/alpha/observatory/night/state": { ...night, actions: night.actions.map((one) => ({ ...one, step: mark })) } }))), "p95 < 500"]);
} finally {
  await browser.close();
  await bus.end();
}
console.log("| what | measured | to reach |\n|---|--:|--:|");
for (const row of rows) console.log(`| ${row.join(" | ")} |`);
