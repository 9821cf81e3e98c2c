// Numbered checks of the pages (checks/telescope.md): frames, how they are found, and the page of one with its pixels, its grid and its header.
import { test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { FRAMES, WCS, known, placeOf, valueAt } from "./known.js";
import { TEST, addressOf, becomes, follow, near, newPage, startRecorded, text, withBrowser } from "./browser.js";

const ID = "demo/alpha";
const HERE = `/t/${ID}`;
const WIDE = { width: 1280, height: 1000 };
const RECORDED = readFileSync(join(import.meta.dirname, "recorded/bus.jsonl"), "utf8").split("\n").filter(Boolean).map((line) => JSON.parse(line));
const [FRAME_KEY, FRAME_BODY] = RECORDED.filter(({ event }) => event?.endsWith("/frame")).map(({ event, body }) => [event.replace("starmesh/v1/", ""), body]).at(-1);

const [bus, browser] = await withBrowser(startRecorded());
const page = await newPage(browser, { viewport: WIDE });
await page.goto(`${bus.url}${HERE}`);
await page.locator('[data-testid="device"]').nth(9).waitFor();

beforeEach(async () => { await bus.reset(); }, TEST);

const open = async (address) => { if (addressOf(page).pathname !== address) await follow(page, bus.url + address); };

const FRAME = FRAME_BODY.id;
const viewer = page.locator('[data-testid="viewer"]');
/** The part of the frame that is in view: left, upper, width and height, px. */
const inView = () => viewer.locator("svg").evaluate((svg) => { const { x, y, width, height } = svg.viewBox.baseVal; return [x, y, width, height]; });
/** Where the picture stands on the page, and how large it is. */
const placeOfPicture = () => viewer.evaluate((one) => { const { x, y, width, height } = one.getBoundingClientRect(); return [x, y + scrollY, width, height]; });
/** Waits until the frame before is known. */
const canBlink = () => page.getByRole("button", { name: "Blink with previous" }).and(page.locator(":enabled")).waitFor();
/** What is read where a pointer comes to a pixel of the frame, wherever that stands at this moment; `x` and `y` count from 0. */
const pointAt = (x, y) => viewer.evaluate(async (one, [px, py]) => {
  const seen = one.querySelector("svg").viewBox.baseVal;
  const box = one.querySelector("canvas").getBoundingClientRect();
  const k = box.width / seen.width;
  one.dispatchEvent(new PointerEvent("pointermove", { bubbles: true, pointerType: "mouse", clientX: box.left + (px + 0.5 - seen.x) * k, clientY: box.top + (py + 0.5 - seen.y) * k }));
  await new Promise((resolve) => { requestAnimationFrame(() => setTimeout(resolve)); });
  return /** @type {any} */ (one.querySelector('[data-testid="readout"]')).innerText.replace(/\s+/g, " ");
}, [x, y]);

test("a search of frames stands in the address and gives just those, whatever their names; keys go through them, blink, and lead back", TEST, async () => {
  await known(page, FRAME);
  const ids = () => page.locator('[data-testid="frame"]').evaluateAll((all) => all.map((one) => one.dataset.frame));
  await open(`${HERE}/frames`);
  await page.getByLabel("Night, by its evening").fill("2026-11-25");
  await page.getByLabel("Type").selectOption("light");
  await page.getByLabel("Exact target").fill("WASP-18");
  await page.keyboard.press("Enter");
  const wanted = [3, 0].map((i) => FRAMES[i].id);
  await becomes(ids, wanted);
  assert.deepEqual(addressOf(page), { pathname: `${HERE}/frames`, night: "20261125", image_type: "light", object: "WASP-18" });
  await page.goto(page.url());
  await becomes(ids, wanted, "by its address alone");
  await becomes(() => page.getByLabel("Exact target").inputValue(), "WASP-18");
  await page.getByRole("button", { name: "List" }).click();
  await page.getByText(FRAMES[3].file).waitFor();
  await open(HERE);
  await open(`${HERE}/frames`);
  await becomes(ids, [6, 5, 4].map((i) => FRAMES[i].id));
  await page.locator("[data-open]").first().focus();
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("Enter");
  await becomes(() => addressOf(page).pathname, `${HERE}/frames/${FRAMES[5].id}`);
  await page.getByText(FRAMES[5].file).waitFor();
  const grey = (x, y) => viewer.locator("canvas").evaluate((one, [px, py]) => /** @type {any} */ (one).getContext("2d").getImageData(Math.floor(px * one.width / 2048), Math.floor(py * one.height / 2048), 1, 1).data[0], [x, y]);
  // The letter is upright: its foot, its arms and what is beside them.
  await becomes(async () => [await grey(500, 1600), await grey(1400, 400), await grey(1000, 1000), await grey(1400, 1000), await grey(1400, 1600), await grey(1800, 400), await grey(200, 1600)].map((one) => one > 128), [true, true, true, false, false, false, false]);
  await page.getByRole("button", { name: "Grid" }).and(page.locator(":disabled")).waitFor();
  await page.locator('[data-testid="no-wcs"]', { hasText: "of 3 stars none fits the catalogue" }).waitFor();
  await canBlink();
  for (const isLit of [false, true]) {
    await page.keyboard.press("b");
    await becomes(async () => (await grey(500, 1600)) > 128, isLit, isLit ? "this frame" : "the frame before has no letter");
  }
  await page.keyboard.press("Escape");
  await becomes(() => addressOf(page).pathname, `${HERE}/frames`);
  await page.locator(`[data-open="${FRAMES[5].id}"]:focus`).waitFor();
});

test("at any zoom the pixel under the pointer has its own number and place, also before its pixels are there, while turns of the wheel follow each other, and in the frame that is blinked to", TEST, async () => {
  await open(HERE);
  // The numbers from column 1280 to 1535 come late.
  let come;
  const late = new Promise((resolve) => { come = resolve; });
  const column = /\/tiles\/3\/5\/\d+$/;
  const wait = async (route) => { await late; await route.fallback(); };
  await page.route(column, wait);
  await open(`${HERE}/frames/${FRAME}`);
  await viewer.waitFor();
  await becomes(inView, ([, , width]) => near(width, 2048, 1), "all of it");
  await becomes(() => pointAt(1000, 1000), (told) => told.startsWith(`x 1001 y 1001 ${valueAt(1000, 1000)} ADU`));
  await becomes(() => pointAt(1300, 1000), (told) => told.startsWith("x 1301 y 1001 — "), "it has no number yet, and not that of another pixel");
  come();
  await becomes(() => pointAt(1300, 1000), (told) => told.startsWith(`x 1301 y 1001 ${valueAt(1300, 1000)} ADU`));
  await page.unroute(column, wait);
  for (const [name, width] of /** @type {const} */ ([["Fit", 2048], ["1:1", null], ["4:1", null]])) {
    await page.getByRole("button", { name, exact: true }).click();
    const [, , across] = await placeOfPicture();
    await becomes(inView, ([, , w]) => near(w, width ?? across / parseInt(name, 10), 1), name);
    for (const [px, py] of [[1000, 1000], [1095, 1003], [1030, 980], [990, 1060], [1024, 1024]]) {
      const told = await becomes(() => pointAt(px, py), (one) => one.startsWith(`x ${px + 1} y ${py + 1} ${valueAt(px, py)} ADU `), `${name} ${px} ${py}`);
      const [ra, dec] = placeOf(WCS, px, py);
      const exact = await page.evaluate(([wcs, x, y]) => import("/assets/pixels.js").then(({ skyOf }) => skyOf(wcs, x, y)), /** @type {const} */ ([WCS, px, py]));
      assert.ok(near(exact[0], ra, 0.1 / 3600) && near(exact[1], dec, 0.1 / 3600), `${exact} is not ${ra} ${dec}`);
      const [h, m, s, sign, d, arcmin, arcsec] = /(\d\d) (\d\d) (\d\d\.\d) ([+−])(\d\d) (\d\d) (\d\d)$/.exec(told).slice(1);
      assert.ok(near(15 * (Number(h) + Number(m) / 60 + Number(s) / 3600), ra, 0.76 / 3600) && near((sign === "−" ? -1 : 1) * (Number(d) + Number(arcmin) / 60 + Number(arcsec) / 3600), dec, 0.51 / 3600), told);
    }
  }
  await page.getByRole("button", { name: "Fit", exact: true }).click();
  const [, , all] = await becomes(inView, ([, , width]) => near(width, 2048, 1), "all of it again");
  // Two turns before a paint: what is under the pointer stays there.
  const under = await viewer.evaluate((one) => {
    const { left, top, width, height } = one.querySelector("canvas").getBoundingClientRect();
    const at = { bubbles: true, cancelable: true, clientX: Math.round(left + width / 3), clientY: Math.round(top + height / 4) };
    for (const deltaY of [-300, -150]) one.dispatchEvent(new WheelEvent("wheel", { deltaY, ...at }));
    return [(at.clientX - left) / width, (at.clientY - top) / height];
  });
  const [x, y, width, height] = await becomes(inView, ([, , w]) => near(w, all / 2 ** 1.5, 1), "both turns count");
  assert.ok(near(x + under[0] * width, under[0] * 2048, 0.1) && near(y + under[1] * height, under[1] * 2048, 0.1), `${x} ${y} ${width} ${height}`);

  await open(`${HERE}/frames/${FRAMES[5].id}`);
  await viewer.waitFor();
  await canBlink();
  const readout = page.locator('[data-testid="readout"]');
  await becomes(() => pointAt(500, 1600), (told) => told.startsWith(`x 501 y 1601 ${valueAt(500, 1600)} ADU`));
  for (const value of [500, valueAt(500, 1600)]) {
    await page.keyboard.press("b");
    await becomes(() => text(readout), (told) => told.startsWith(`x 501 y 1601 ${value} ADU`), "by the frame that is shown");
  }
});

test("what comes late beside a frame or above it moves it nowhere", TEST, async () => {
  await open(HERE);
  const { id } = FRAMES[5];
  let list;
  const listed = new Promise((resolve) => { list = resolve; });
  const lateList = async (route) => { if (/limit=1000/.test(route.request().url())) await listed; await route.fallback(); };
  let measured = false;
  const lateFacts = async (route) => {
    if (measured || route.request().resourceType() === "document") return route.fallback();
    const response = await route.fetch();
    return route.fulfill({ json: { ...(await response.json()), id, facts: null } });
  };
  const [frame, level] = [new RegExp(`/frames/${id}$`), /\/tiles\/3\/\d+\/\d+$/];
  await page.route(/\/frames\?/, lateList);
  await page.route(frame, lateFacts);
  await open(`${HERE}/frames/${id}`);
  await viewer.waitFor();
  const why = page.locator('[data-testid="no-wcs"]');
  await why.filter({ hasText: "it is not measured yet" }).waitFor();
  const close = () => page.locator('.scope [data-testid="close"]').boundingBox();
  const [place, button] = [await placeOfPicture(), await close()];
  const stays = async (what) => assert.deepEqual(await placeOfPicture(), place, what);

  measured = true;
  await why.filter({ hasText: "of 3 stars none fits the catalogue" }).waitFor();
  await stays("what was measured");
  list();
  await canBlink();
  await stays("the frames of the night");
  await page.keyboard.press("b");
  await page.getByText("the previous frame", { exact: true }).waitFor();
  await stays("blinking");
  await page.keyboard.press("b");
  const refuse = (route) => route.fulfill({ status: 503, json: { title: "Busy", detail: "The archive is busy." } });
  await page.route(level, refuse);
  await page.getByRole("button", { name: "4:1", exact: true }).click();
  const missing = page.locator('[data-testid="missing-tiles"]');
  await missing.waitFor();
  await stays("tiles that are missing");
  await page.unroute(level, refuse);
  await missing.getByRole("button", { name: "Try again" }).click();
  await missing.waitFor({ state: "detached" });
  await stays("and come");
  const alert = { id: "dome-not-closed/dome", priority: "critical", cause: "It is half open.", consequence: "Rain comes in.", action: "Look at it.", raised_utc: "2026-11-27T02:21:10.000000Z" };
  await bus.put({ [`${ID}/observatory/alerts/state`]: { alerts: [alert] } });
  const banner = page.locator('[data-testid="banner"]');
  await banner.filter({ hasText: "alpha: It is half open." }).waitFor();
  await stays("the bar of an alert");
  assert.deepEqual(await close(), button, "and Close stays where it was");
  const { y, height } = await banner.boundingBox();
  assert.ok(y > WIDE.height / 2 && y + height <= WIDE.height, `${y} ${height}: the bar is in view`);
  await page.unroute(/\/frames\?/, lateList);
  await page.unroute(frame, lateFacts);
});

test("the words of a telescope that falls silent move the frame below them nowhere, however wide the screen is", TEST, async () => {
  await open(`${HERE}/frames/${FRAMES[5].id}`);
  await viewer.waitFor();
  /** Its words, and where the frame begins, px: while it is heard, and ten minutes after its last message. */
  const measured = () => page.evaluate(async (id) => {
    const { net } = await import("/assets/store.js");
    const own = net.value;
    const found = [];
    for (const more of [{}, { age_s: 600 }]) {
      net.value = new Map(own).set(id, { ...own.get(id), ...more });
      await new Promise((resolve) => { requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(resolve))); });
      found.push([document.querySelector(".scope .words").textContent, document.querySelector('[data-testid="viewer"]').getBoundingClientRect().y + scrollY]);
    }
    net.value = own;
    return found;
  }, ID);
  for (const width of [1280, 1000, 900, 840, 780]) {
    await page.setViewportSize({ ...WIDE, width });
    const [[, heard], [, silent]] = await becomes(measured, ([[before], [after]]) => /SAFE.*OPEN/.test(before) && /SAFETY UNKNOWN.*DOME UNKNOWN/.test(after), "its words");
    assert.equal(silent, heard, `${width} px`);
  }
  await page.setViewportSize(WIDE);
});

test("the grid of a frame has names, and the header is whole, in its order and searched", TEST, async () => {
  await open(`${HERE}/frames/${FRAME}`);
  await viewer.waitFor();
  await page.getByRole("button", { name: "Fit" }).click();
  await page.getByRole("button", { name: "Grid" }).click();
  const names = await becomes(() => viewer.locator("svg text").evaluateAll((all) => all.map((one) => one.textContent)), (all) => all.filter((one) => /^\d\d \d\d \d\d$/.test(one)).length > 1 && all.filter((one) => /^[+−]\d\d \d\d \d\d$/.test(one)).length > 1, "names of both kinds");
  assert.equal(new Set(names).size, names.length);
  const header = () => page.locator('[data-testid="header"] tr').evaluateAll((all) => all.map((one) => [one.children[0].textContent, one.children[1].textContent].join(" ")));
  await becomes(header, ["SIMPLE true", "OBJECT 'WASP-18'", "HISTORY 'bias taken off'", "COMMENT 'by hand'", "HISTORY 'flat divided'", "HISTORY 'bias taken off'"]);
  for (const [words, expected] of /** @type {const} */ ([["object", 1], ["divided", 1], ["name of the target", 1], ["history", 3], ["no such thing", 0]])) {
    await page.getByLabel("Find in the header").fill(words);
    await becomes(async () => (await header()).length, expected, words);
  }
});

test("a frame that is looked into stays as it is when another is taken, and that is a touch away", TEST, async () => {
  await open(`${HERE}/frames/${FRAME}`);
  await page.getByRole("button", { name: "4:1", exact: true }).click();
  const before = await becomes(inView, ([, , width]) => width < 600, "zoomed");
  const newest = page.locator('[data-testid="newest"]');
  assert.equal(await newest.count(), 0);
  const place = await placeOfPicture();
  await bus.events([[FRAME_KEY, { ...FRAME_BODY, id: "01a21900-0000-7000-8000-000000000000", started_utc: "2026-11-27T02:27:36.000000Z" }]]);
  await newest.filter({ hasText: "Newest frame 02:27:36" }).waitFor();
  assert.deepEqual([await inView(), await placeOfPicture()], [before, place]);
  assert.equal(addressOf(page).pathname, `${HERE}/frames/${FRAME}`);
  await newest.click();
  await becomes(() => addressOf(page).pathname, `${HERE}/frames/01a21900-0000-7000-8000-000000000000`);
  await page.unrouteAll({ behavior: "ignoreErrors" });
});
