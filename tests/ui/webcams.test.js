// Webcams, on a recorded bus: two cameras that answer, one whose site is another, and one that gives no picture. Their server belongs to this test.
import { test, after } from "node:test";
import assert from "node:assert/strict";
import http from "node:http";
import { network } from "./recorded/network.js";
import { TEST, becomes, looks, newPage, problemsOf, settled, startRecorded, tooWide, withBrowser } from "./browser.js";

const PICTURE = '<svg xmlns="http://www.w3.org/2000/svg" width="320" height="200"><rect width="320" height="200" fill="#357"/></svg>';
/** What was asked, by camera, and whether it gives its picture now. */
const asked = { sky: [], dome: [], broken: [], ridge: [], slow: [] };
const gives = { sky: true, dome: true, broken: false, ridge: true, slow: true };
const cameras = http.createServer((request, response) => {
  const [, name] = /^\/(\w+)/.exec(request.url) ?? [];
  asked[name]?.push(request);
  if (name === "slow") return;
  if (!gives[name]) return void response.writeHead(200, { "content-type": "text/html" }).end("<h1>Log in</h1>");
  response.writeHead(200, { "content-type": "image/svg+xml", "cache-control": "max-age=3600" }).end(PICTURE);
});
await new Promise((resolve) => { cameras.listen(0, "127.0.0.1", resolve); });
const origin = `http://127.0.0.1:${cameras.address().port}`;
const webcam = (name, path, more, periodS = 1) => `[[web.webcam]]\nname = ${JSON.stringify(name)}\nurl = "${origin}/${path}"\nperiod_s = ${periodS}\n${more}\n`;
const [bus, browser] = await withBrowser(startRecorded({ web: [
  webcam('<img src=x onerror="window.taken=1"> all-sky', "sky?size=2&name=a%20b+c", ""), webcam("Dome of alpha", "dome", 'telescope = "alpha"'),
  webcam("Broken", "broken", 'telescope = "beta"'), webcam("Ridge", "ridge", 'site = "ridge"'), webcam("Slow", "slow", 'site = "ridge"\ntelescope = "gamma"', 600),
].join("") }));
await network(bus);
const page = await newPage(browser);
// Each picture that the page begins to fetch: its server learns of it some time later.
await page.addInitScript(() => {
  const { Image } = window;
  window.begun = [];
  window.Image = function Noted() {
    const image = new Image();
    window.begun.push(image);
    return image;
  };
});
const all = problemsOf(page);
const problems = () => all.filter((one) => !one.includes(`asks ${origin}/`));
await page.goto(bus.url);
await page.locator('[data-telescope="ridge/delta"][data-level="p1"]').waitFor();
after(() => {
  cameras.closeAllConnections();
  cameras.close();
});

const cam = (name) => page.locator(`[data-webcam*="${name}"]`);
const names = async () => (await page.locator("[data-webcam]").evaluateAll((all) => all.map((one) => one.dataset.webcam.split(" ").pop()))).sort();
async function open(address) {
  await page.goto(bus.url + address);
  await settled(page);
  await page.locator("[data-webcam]").first().waitFor();
}
/** Waits until a camera was asked so many times more. */
async function moreOf(name, count) {
  const until = asked[name].length + count;
  await becomes(() => asked[name].length, (times) => times >= until, `${name} is asked`);
}
const comesIntoView = (name) => cam(name).scrollIntoViewIfNeeded();

test("a telescope shows its webcams and those of its site, a site all of its own, and an alert those of its telescope", TEST, async () => {
  for (const [address, expected] of [["/t/demo/alpha", ["all-sky", "alpha"]], ["/t/demo/beta", ["Broken", "all-sky"]], ["/t/demo/alpha/weather", ["all-sky", "alpha"]], ["/t/ridge/delta", ["Ridge"]],
    ["/weather", ["Broken", "Ridge", "Slow", "all-sky", "alpha"]], ["/alerts", ["Ridge"]]]) {
    await open(address);
    await becomes(names, expected, address);
  }
});

test("a picture is asked for again with its own query, past every cache, and its name is text", TEST, async () => {
  await open("/t/demo/alpha");
  await comesIntoView("all-sky");
  await cam("all-sky").locator("img").waitFor();
  await moreOf("sky", 2);
  const urls = asked.sky.slice(-2).map(({ url }) => url);
  for (const url of urls) assert.match(url, /^\/sky\?size=2&name=a%20b\+c&starmesh=\d+$/);
  assert.notEqual(urls[0], urls[1]);
  assert.equal(asked.sky.at(-1).headers.referer, undefined, "the camera's server is not told who looks");
  await page.locator('[data-webcam*="all-sky"][data-quality="fresh"]').waitFor();
  assert.equal(await cam("all-sky").locator("h2").textContent(), '<img src=x onerror="window.taken=1"> all-sky');
  await moreOf("dome", 1);
  assert.match(asked.dome.at(-1).url, /^\/dome\?starmesh=\d+$/);
  assert.equal(await page.evaluate(() => window.taken), undefined);
});

test("it is asked for only while somebody can see it", TEST, async () => {
  await page.setViewportSize({ width: 390, height: 500 });
  await open("/t/demo/alpha/weather");
  const seen = async (state) => page.evaluate((value) => { Object.defineProperty(document, "visibilityState", { configurable: true, get: () => value }); document.dispatchEvent(new Event("visibilitychange")); }, state);
  const begun = () => page.evaluate(() => window.begun.filter(({ alt }) => alt.includes("all-sky")).length);
  /** How many more it begins to fetch in seconds in which it would have asked for some. */
  const begins = async () => {
    const before = await begun();
    for (let i = 0; i < 3; i += 1) await page.evaluate(() => new Promise((resolve) => { setTimeout(resolve, 1000); }));
    return (await begun()) - before;
  };
  await comesIntoView("all-sky");
  await moreOf("sky", 2);
  assert.ok(await begun() > 1);
  await seen("hidden");
  assert.equal(await begins(), 0, "a hidden page asks for nothing");
  await seen("visible");
  await moreOf("sky", 2);
  // The page has learned of it when this younger observer has.
  await page.evaluate(() => new Promise((resolve) => {
    document.querySelector("[data-webcam]").style.marginTop = "3000px";
    scrollTo(0, 0);
    new IntersectionObserver((found) => { if (!found.at(-1).isIntersecting) resolve(); }, { rootMargin: "100px" }).observe(document.querySelector('[data-webcam*="all-sky"] > div'));
  }));
  assert.equal(await begins(), 0, "nor for what is far from the part that is shown");
  await page.setViewportSize({ width: 1280, height: 900 });
});

test("when the camera fails, the last good picture stays, as old, and is live again afterwards", TEST, async () => {
  await open("/t/demo/alpha");
  await comesIntoView("Dome");
  const dome = cam("Dome");
  await page.locator('[data-webcam*="Dome"][data-quality="fresh"] img').waitFor();
  gives.dome = false;
  await page.locator('[data-webcam*="Dome"][data-state="failed"]').waitFor();
  assert.notEqual(await dome.getAttribute("data-quality"), "fresh");
  assert.match(await dome.textContent(), /stale|old/);
  assert.match(await dome.textContent(), /The last try failed: its server gives no picture/);
  assert.ok(await dome.locator("img").evaluate((image) => image.naturalWidth > 0), "what is shown is the last good picture, not a broken one");
  await page.locator('[data-webcam*="Dome"][data-quality="lost"]').waitFor();
  gives.dome = true;
  await page.locator('[data-webcam*="Dome"][data-quality="fresh"][data-state="shown"]').waitFor();
  await becomes(() => dome.textContent(), (text) => !/stale|old/.test(text.replace("Dome", "")), "it is not called old");
});

test("what never gave a picture says so, and what does not answer shows none", TEST, async () => {
  await open("/t/demo/beta");
  await comesIntoView("Broken");
  await page.locator('[data-webcam="Broken"][data-state="failed"]').waitFor();
  assert.equal(await cam("Broken").locator("img").count(), 0);
  assert.match(await cam("Broken").textContent(), /No picture: its server gives no picture, or cannot be reached from here/);
  await open("/t/ridge/gamma");
  await comesIntoView("Slow");
  await becomes(() => asked.slow.length > 0, true);
  assert.equal(await cam("Slow").locator("img").count(), 0);
  await cam("Slow").filter({ hasText: /no picture.*Fetching/s }).waitFor();
});

test("it opens large, stays live there, and Escape leads back to it", TEST, async () => {
  await open("/t/demo/alpha");
  await comesIntoView("Dome");
  const button = page.getByRole("button", { name: "Dome of alpha, open large" });
  await button.click();
  const dialog = page.getByRole("dialog", { name: "Dome of alpha" });
  await dialog.locator("img").waitFor();
  await moreOf("dome", 2);
  await becomes(() => dialog.locator("img").evaluate((image) => image.naturalWidth > 0), true, "it has its picture");
  await page.keyboard.press("Escape");
  await dialog.waitFor({ state: "detached" });
  await becomes(() => page.evaluate(() => document.activeElement.getAttribute("aria-label")), "Dome of alpha, open large");
  await button.locator("img").waitFor();
});

test("webcams of each state have no serious finding of axe-core in three themes, and fit", TEST, async () => {
  const found = [];
  for (const address of ["/t/demo/beta", "/weather"]) {
    await open(address);
    await comesIntoView("Broken");
    await page.locator('[data-webcam="Broken"][data-state="failed"]').waitFor();
    found.push(...(await looks(page, address)));
  }
  await page.setViewportSize({ width: 1280, height: 900 });
  await open("/t/demo/alpha");
  await comesIntoView("Dome");
  await page.getByRole("button", { name: "Dome of alpha, open large" }).click();
  await page.getByRole("dialog").locator("img").waitFor();
  found.push(...(await looks(page, "large")));
  assert.deepEqual(found, []);
});

test("whatever the list brings, nothing of it becomes an address or markup, and a list that cannot be read is told", TEST, async () => {
  let answer = { webcams: [null, 7, { name: 7, url: "https://a" }, { name: "script", url: "javascript:window.taken=1", site_id: "demo" }, { name: "data", url: "data:image/svg+xml,x", site_id: "demo" },
    { name: "none", site_id: "demo" }, { name: `${"W".repeat(600)}<script>window.taken=1</script>`, url: `${bus.url}/assets/favicon.svg`, site_id: "demo", period_s: "x" }] };
  await page.route(`${bus.url}/api/v1/network`, (route) => route.fulfill(answer ? { json: answer } : { status: 503, json: { title: "Not now", detail: "Not now." } }));
  await page.setViewportSize({ width: 390, height: 844 });
  await open("/t/demo/alpha");
  await becomes(() => page.locator("[data-webcam]").count(), 1);
  assert.equal(await page.evaluate(() => window.taken), undefined);
  assert.equal(await tooWide(page), null);
  answer = null;
  await page.reload();
  await page.locator('[data-testid="webcams-unknown"]').waitFor();
  assert.match(await page.locator('[data-testid="webcams-unknown"]').textContent(), /cannot be read.*Not now\..*Try again/);
  await page.unroute(`${bus.url}/api/v1/network`);
  await page.getByRole("button", { name: "Try again" }).click();
  await page.locator('[data-webcam="Dome of alpha"]').waitFor();
  assert.deepEqual(problems().filter((one) => !/status of 503/.test(one)), []);
});
