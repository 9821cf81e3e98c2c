// What the numbered checks of the pages (tests/ui/checks/telescope.md) say in milliseconds, bytes and pictures a second, on a recorded bus and the machine that runs it.
import { after, afterEach, test } from "node:test";
import assert from "node:assert/strict";
import { TEST, follow, launch, newPage, settled, startRecorded } from "../browser.js";

const ID = "demo/alpha";
const FRAME = "01a218a1-5754-7476-83d3-56cf993d96d8";
const bus = await startRecorded();
const browser = await launch();
const recorded = await bus.states();
const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];
let page;

after(async () => {
  await browser.close();
  await bus.end();
}, TEST);
afterEach(async () => {
  await page?.unrouteAll({ behavior: "ignoreErrors" });
  await page?.close();
  await bus.reset();
}, TEST);

async function open(address, prepare = async () => {}) {
  page = await newPage(browser, { viewport: { width: 1280, height: 1000 } });
  await prepare();
  await page.goto(bus.url + address);
  await settled(page);
}

/** Waits in the page, which looks in each of its frames, until something of it is so, written as a page would; gives the seconds that took. */
const shown = (what) => page.evaluate(`new Promise((resolve) => {
  const began = performance.now();
  const look = () => ((${what}) ? resolve((performance.now() - began) / 1000) : requestAnimationFrame(look));
  look();
})`);

test("another stretch of a frame of 2048 x 2048 px is there within 150 ms, fitted and pixel by pixel", TEST, async () => {
  await open(`/t/${ID}/frames/${FRAME}`);
  for (const zoom of ["1:1", "Fit"]) {
    await page.getByRole("button", { name: zoom, exact: true }).click();
    await page.waitForLoadState("networkidle");
    const took = [];
    for (const curve of ["sqrt", "log", "linear", "asinh", "sqrt", "log", "linear", "asinh"]) {
      took.push(await page.getByRole("button", { name: curve, exact: true }).evaluate((button) => new Promise((resolve) => {
        const canvas = document.querySelector('[data-testid="viewer"] canvas');
        const observer = new MutationObserver(() => { observer.disconnect(); resolve(performance.now() - began); });
        observer.observe(canvas, { attributes: true, attributeFilter: ["data-painted"] });
        const began = performance.now();
        button.click();
      })));
    }
    console.log(`${zoom}: ${took.map((ms) => ms.toFixed(0)).join(", ")} ms`);
    assert.ok(median(took) < 150, `${zoom}: ${took}`);
  }
});

test("over 10 Mbit/s the picture of a frame of 4096 x 4096 px is there within 0.8 s and 250 kB, and sharper afterwards", TEST, async () => {
  // The first tile is the whole frame, whatever its size.
  await open(`/t/${ID}/frames`, () => page.route(/\/frames\/[0-9a-f-]+$/, async (route) => {
    if (route.request().resourceType() === "document") return route.fallback();
    const response = await route.fetch();
    await route.fulfill({ response, json: { ...(await response.json()), width_px: 4096, height_px: 4096 } });
  }));
  await page.waitForLoadState("networkidle");
  const client = await page.context().newCDPSession(page);
  await client.send("Network.enable");
  await client.send("Network.emulateNetworkConditions", { offline: false, latency: 20, downloadThroughput: 10e6 / 8, uploadThroughput: 10e6 / 8 });
  let bytes = 0;
  client.on("Network.dataReceived", ({ encodedDataLength, dataLength }) => { bytes += encodedDataLength || dataLength; });
  const opened = page.evaluate((to) => import("/assets/route.js").then(({ go }) => go(to)), `/t/${ID}/frames/${FRAME}`);
  const took = await shown(`(() => { const canvas = document.querySelector('[data-testid="viewer"] canvas'); return canvas?.width > 0 && canvas.getContext("2d").getImageData(canvas.width / 2 - 20, canvas.height / 2 - 20, 40, 40).data.some((one, i) => i % 4 !== 3 && one > 0); })()`);
  const first = bytes;
  await opened;
  await page.locator('[data-testid="viewer"] canvas[data-painted]').waitFor();
  console.log(`first picture after ${took.toFixed(2)} s and ${(first / 1000).toFixed(0)} kB, all of it ${(bytes / 1000).toFixed(0)} kB`);
  assert.ok(took < 0.8 && first < 250_000, `${took} s, ${first} bytes`);
});

test("three days of twelve parameters are drawn within 1.5 s", TEST, async () => {
  await open(`/t/${ID}/weather`, () => page.route(/\/series\?/, (route) => {
    const asked = new URL(route.request().url()).searchParams;
    const [count, from] = [Number(asked.get("points")), Date.parse(asked.get("from_utc"))];
    const points = Array.from({ length: count }, (_, i) => ({ at_utc: new Date(from + (i * 72 * 3600e3) / count).toISOString(), count: 300, min: 1 + Math.sin(i), mean: 2 + Math.sin(i), max: 3 + Math.sin(i) }));
    return route.fulfill({ json: { rows: asked.get("properties").split(",").map((one) => { const [kind, device, property] = one.split("/"); return { series: { kind, device, property, piece_s: 1080, points, gaps: [] } }; }), truncated: false } });
  }));
  await page.locator('[data-testid="chart"] .panel canvas').nth(11).waitFor();
  const took = await page.getByRole("button", { name: "3 d", exact: true }).first().evaluate((button) => new Promise((resolve) => {
    const began = performance.now();
    button.click();
    const look = () => {
      const chart = /** @type {HTMLElement} */ (document.querySelector('[data-testid="chart"]'));
      const isThere = chart && Number(chart.dataset.to) - Number(chart.dataset.from) > 71 * 3600e3 && chart.querySelectorAll(".panel canvas").length === 12;
      if (isThere) requestAnimationFrame(() => resolve((performance.now() - began) / 1000));
      else requestAnimationFrame(look);
    };
    look();
  }));
  console.log(`three days after ${took.toFixed(2)} s`);
  assert.ok(took < 1.5, `${took} s`);
});

test("a chart of as many corrections as the page asks for is dragged and zoomed at 50 pictures a second", TEST, async () => {
  let count = 0;
  await open(`/t/${ID}/guiding`, () => page.route(/\/guiding\/corrections\?/, (route) => {
    const asked = new URL(route.request().url()).searchParams;
    const [most, from] = [Number(asked.get("limit")), Date.parse(asked.get("from_utc"))];
    count = most;
    const rows = Array.from({ length: most }, (_, i) => ({ correction: { frame: `f${i}`, camera: "camera", mid_utc: new Date(from + (i * 7190e3) / most + 5000).toISOString(), pier_side: "east", stars: 20 + (i % 3), fwhm_px: 2.5, east: { error_px: Math.sin(i), given_ms: i % 50, why: "corrected" }, north: { error_px: Math.cos(i), given_ms: i % 40, why: "corrected" } } }));
    return route.fulfill({ json: { rows, truncated: false } });
  }));
  await page.locator('[data-testid="chart"] .panel canvas').nth(3).waitFor();
  const took = await page.locator('[data-testid="chart"]').evaluate((chart) => new Promise((resolve) => {
    const keys = ["+", ...Array(40).fill(null).map((_, i) => (i % 10 === 9 ? "+" : i % 20 === 19 ? "-" : "ArrowLeft"))];
    const steps = [];
    let last = null;
    const next = (now) => {
      if (last !== null) steps.push(now - last);
      last = now;
      if (!keys.length) return resolve(steps);
      const key = keys.shift();
      chart.dispatchEvent(new KeyboardEvent("keydown", { key, shiftKey: key === "ArrowLeft", bubbles: true }));
      return requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
  }));
  console.log(`${count} corrections: ${took.map((ms) => ms.toFixed(0)).join(", ")} ms`);
  assert.ok(median(took) <= 20, `${median(took)} ms a picture of ${count} corrections`);
});

test("UNSAFE is shown within 2 s of the verdict, and a point of a focus run within 1 s", TEST, async () => {
  const [safety, focus] = ["safety", "focus"].map((name) => `${ID}/observatory/${name}/state`);
  await open(`/t/${ID}/weather`);
  const word = shown("document.querySelector('[data-testid=\"reasons\"] [data-safety=\"unsafe\"]')");
  await bus.put({ [safety]: { ...recorded[safety], verdict: "unsafe", reasons: [{ input: "weather/Humidity", why: "84 % is above 80 %", clears_in_s: 9000 }] } });
  const unsafe = await word;
  await follow(page, `${bus.url}/t/${ID}/focus`);
  const took = [];
  for (let n = 1; n <= 8; n += 1) {
    const points = Array.from({ length: n }, (_, i) => ({ position: 23_000 + 50 * i, pass: "coarse", value: 3 + i, error: 0.1, stars: 20, frames: [] }));
    const seen = shown(`document.querySelectorAll("circle.pt").length === ${n}`);
    await bus.put({ [focus]: { ...recorded[focus], active: true, run: { id: FRAME, camera: "camera", focuser: "focuser", filter_offset: 0, night: "20261126", started_utc: "2026-11-27T02:20:00Z", outcome: "running", start_position: 25_000, operator: "hfd", value_label: "HFD, px", points } } });
    took.push(await seen);
  }
  console.log(`UNSAFE after ${unsafe.toFixed(2)} s, points after ${took.map((s) => s.toFixed(2)).join(", ")} s`);
  assert.ok(unsafe < 2 && Math.max(...took) < 1, `${unsafe} ${took}`);
});
