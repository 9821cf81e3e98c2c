// What somebody with a phone and one minute reads off the first pages: who needs him, what does not answer, what is drawn, and how old it is.
import { test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { network } from "./recorded/network.js";
import { TEST, becomes, boxOf, follow, fresh, newPage, problemsOf, startRecorded, withBrowser } from "./browser.js";

const WIDE = { width: 1280, height: 900 };
const PHONE = { width: 390, height: 844 };
const MOUNT = "demo/alpha/device/telescope/mount/state";

const [bus, browser] = await withBrowser(startRecorded());
const recorded = await bus.states();
const page = await newPage(browser);
const problems = problemsOf(page);
/** How much faster than real time the sky runs, in the place of what the server says. */
let speed = null;

beforeEach(async () => {
  speed = null;
  await bus.reset();
  await network(bus);
  problems.length = 0;
}, TEST);

async function open(address, viewport) {
  await page.setViewportSize(viewport);
  await follow(page, bus.url + address);
}

const tile = (id) => page.locator(`[data-testid="tile"][data-telescope="${id}"]`);
const text = (locator) => locator.evaluate((one) => one.innerText.replace(/\s+/g, " "));
/** The mount of alpha has lost its link, as its device node says it. */
const withoutMount = () => ({ ...recorded[MOUNT], link: { is: "lost", reason: "connection closed" }, fields: Object.fromEntries(Object.keys(recorded[MOUNT].fields).map((name) => [name, { no_data: "connection closed" }])) });
/** delta is closed and safe, so that nothing is critical; beta's focus has failed. */
const quiet = async () => {
  const { "demo/alpha/observatory/night/state": night, "demo/alpha/observatory/safety/state": safety } = recorded;
  await bus.put({ "ridge/delta/observatory/alerts/state": { alerts: [] }, "ridge/delta/observatory/safety/state": safety, "ridge/delta/observatory/night/state": { ...night, actions: [], posture: "closed" } });
};

test("the sentence at the top says what is true now, and then what is for later", TEST, async () => {
  await open("/", WIDE);
  const lede = page.locator('[data-testid="lede"]');
  await lede.filter({ hasText: /^delta needs you now\. beta needs you later tonight\. / }).waitFor();
  await quiet();
  await lede.filter({ hasText: /^Nothing needs you now\. beta needs you later tonight\. / }).waitFor();
  const advisory = { id: "disk-low", priority: "advisory", cause: "The disk fills.", consequence: "None yet.", action: "Look at it.", raised_utc: "2026-11-27T02:21:10.000000Z" };
  await bus.put({ "demo/beta/observatory/alerts/state": { alerts: [advisory] } });
  await lede.filter({ hasText: /^Nothing needs you\. beta has something that can wait till tomorrow\. / }).waitFor();
  assert.deepEqual(problems, []);
});

test("a device that the step needs and that does not answer stands beside the step, on the card, the wall and the telescope's page", TEST, async () => {
  await open("/", WIDE);
  await tile("demo/alpha").filter({ hasText: "exposing 10 of 20" }).waitFor();
  await bus.put({ [MOUNT]: withoutMount() });
  const missing = '[data-testid="missing"][data-device="telescope/mount"]';
  const said = /^mount has not answered for \d+ s$/;
  await tile("demo/alpha").locator(missing).filter({ hasText: said }).waitFor();
  assert.match(await tile("demo/alpha").locator(missing).getAttribute("class"), /ink-p2/);
  await tile("demo/alpha").filter({ hasText: "exposing 10 of 20" }).waitFor();
  await tile("demo/alpha").filter({ hasText: "9 of 10 devices answer" }).waitFor();
  for (const address of ["/t/demo/alpha", "/wall"]) {
    await open(address, WIDE);
    await page.locator(missing).filter({ hasText: said }).waitFor();
  }
  await open("/t/demo/alpha", WIDE);
  await page.locator('[data-testid="devices"] header', { hasText: "9 of 10 devices answer" }).waitFor();
  await page.locator('[data-device="telescope/mount"][data-testid="device"]', { hasText: "does not answer" }).waitFor();
  await bus.put({ [MOUNT]: recorded[MOUNT] });
  await page.locator(missing).waitFor({ state: "detached" });
  await page.locator('[data-testid="devices"] header', { hasText: "10 of 10 devices answer" }).waitFor();
  // Nothing comes of it any more, and its last word was that all is well.
  await bus.put({ [MOUNT]: null });
  await page.locator(missing).filter({ hasText: said }).waitFor();
  assert.deepEqual(problems, []);
});

test("a card counts its step down in the words of the telescope's page, and tells by how much it is late", TEST, async () => {
  const state = "demo/beta/observatory/night/state";
  const night = (await bus.states())[state];
  const due = (utc) => bus.put({ [state]: { ...night, actions: [{ ...night.actions[0], expected_by_utc: utc }] } });
  for (const [viewport, ahead] of /** @type {const} */ ([[WIDE, /^should end by 09:00:00, in \d h \d+ min$/], [PHONE, /^should end in \d h \d+ min$/]])) {
    await due("2026-11-27T09:00:00.000000Z");
    await open("/", viewport);
    const expected = tile("demo/beta").locator('[data-testid="expected"]');
    await expected.waitFor();
    await becomes(() => text(expected), (said) => ahead.test(said), "counted down");
    const lines = await expected.evaluate((one) => one.getBoundingClientRect().height / parseFloat(getComputedStyle(one).lineHeight));
    assert.ok(viewport === WIDE || lines < 1.5, `${lines} lines on a phone`);
    await due("2026-11-27T02:20:00.000000Z");
    await expected.filter({ hasText: /^should have ended \d+ (min|h) .*ago$/ }).waitFor();
    await becomes(() => expected.getAttribute("class"), (name) => /ink-p2/.test(name), "it stands out");
    const [said, card] = await Promise.all([expected, tile("demo/beta")].map(boxOf));
    assert.ok(said.x >= card.x && said.x + said.width <= card.x + card.width && said.y + said.height <= card.y + card.height, `${viewport.width} px: it stays in its card`);
  }
  await bus.put({ [state]: night });
  await tile("demo/beta").locator('[data-testid="expected"]').waitFor({ state: "detached" });
  assert.deepEqual(problems, []);
});

test("the last image has the measures of its own frame, though those of the next one are here already", TEST, async () => {
  await open("/t/demo/alpha", WIDE);
  const card = page.locator('section[aria-label="Last image"]');
  const measured = async () => (await text(card.locator(".stats"))).replace(/^FWHM /, "");
  const expected = "5.76 ″ Stars 55 Sky 768 ADU Trailed no";
  await becomes(measured, expected, "those of the newest frame");
  const next = "01a218a1-ffff-7476-83d3-56cf993d96d8";
  await bus.events([[`demo/alpha/observatory/frame/${next}/facts`, { frame: next, camera: "camera", started_utc: "2026-11-27T02:24:45.000000Z", stars: 7, fwhm_px: 9, sky_adu: 1 }]]);
  await page.locator('[data-testid="focus-card"] header', { hasText: "—" }).waitFor();
  await becomes(measured, expected, "the archive has them");
  assert.deepEqual(problems, []);
});

test("the night has the present target and the Moon by name, and no label lies on another", TEST, async () => {
  /** Pairs of texts of a timeline that overlap. */
  const overlaps = (selector) => page.locator(`${selector} svg`).evaluateAll((all) => all.flatMap((svg) => {
    const texts = [...svg.querySelectorAll("text")].map((one) => [one.textContent, one.getBoundingClientRect()]);
    return texts.flatMap(([a, p], i) => texts.slice(i + 1).filter(([, q]) => p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 3 && q.top < p.bottom - 3).map(([b]) => `${a} | ${b}`));
  }));
  for (const viewport of [WIDE, PHONE]) {
    await open("/t/demo/alpha", viewport);
    const night = page.locator('[data-testid="night"]');
    await night.locator(".b-next").first().waitFor();
    await becomes(() => night.locator('[data-testid="present"]').getAttribute("d"), (path) => path?.split("L").length > 5, "a curve");
    await night.locator("svg text.h", { hasText: /^WASP-18$/ }).waitFor();
    await night.locator("svg text", { hasText: /^Moon \d+ %$/ }).waitFor();
    await becomes(() => overlaps('[data-testid="timeline"]'), [], "one telescope");
    await open("/", viewport);
    await page.locator('[data-testid="nights"]').scrollIntoViewIfNeeded();
    await page.locator('[data-testid="night-line"] .b-done, [data-testid="night-line"] .b-run').first().waitFor();
    await becomes(() => overlaps('[data-testid="nights"] .touch'), [], "all telescopes");
    const looks = await page.locator('[data-testid="nights"] .bar-key rect').evaluateAll((all) => all.map((one) => { const { fill, strokeDasharray } = getComputedStyle(one); return `${fill} ${strokeDasharray}`; }));
    assert.equal(new Set(looks).size, 4, `the legend has four looks: ${looks}`);
  }
  assert.deepEqual(problems, []);
});

test("a phone has the whole switch of the view, what to do, and one Close of a telescope on a screen", TEST, async () => {
  for (const address of ["/", "/alerts", "/t/ridge/delta", "/t/ridge/delta/controls"]) {
    await open(address, PHONE);
    const banner = page.locator('[data-testid="banner"]');
    await banner.getByRole("link", { name: "What to do" }).waitFor();
    const lines = await banner.locator("p").evaluate((one) => one.getBoundingClientRect().height / parseFloat(getComputedStyle(one).lineHeight));
    assert.ok(lines < 3.5, `${address}: the text of the bar has ${lines} lines`);
    await becomes(() => page.locator('[data-testid="close"][aria-label="Close ridge/delta"]:visible').count(), 1, address);
    const box = await boxOf(page.locator('[data-testid="close"][aria-label="Close ridge/delta"]:visible'));
    assert.ok(box.y >= 0 && box.y + box.height <= PHONE.height, `${address}: Close is in view without scrolling`);
  }
  await open("/", PHONE);
  for (const name of ["Cards", "Compact"]) {
    const box = await boxOf(page.getByRole("button", { name, exact: true }));
    assert.ok(box.x >= 0 && box.x + box.width <= PHONE.width, `${name} is cut: ${JSON.stringify(box)}`);
  }
});

test("the words of a card stand in one line, simulated or not", TEST, async () => {
  for (const viewport of [WIDE, { width: 1440, height: 900 }, PHONE]) {
    await open("/", viewport);
    await tile("ridge/gamma").filter({ hasText: "UNSAFE" }).waitFor();
    const tops = await tile("ridge/gamma").locator(".word, .mode:not(.sim)").evaluateAll((all) => all.map((one) => { const { top, bottom } = one.getBoundingClientRect(); return (top + bottom) / 2; }));
    assert.equal(tops.length, 3);
    assert.ok(Math.max(...tops) - Math.min(...tops) < 6, `${viewport.width} px: ${tops}`);
    const [badge, name] = await Promise.all([".mode.sim", ".tile-h b"].map((part) => boxOf(tile("ridge/gamma").locator(part))));
    assert.ok(Math.abs(badge.y + badge.height / 2 - name.y - name.height / 2) < 6, "SIMULATION stands beside the name");
  }
});

test("under a sky that runs faster, ages say that they are of real time, and the image's is of the sky", TEST, async () => {
  speed = 60;
  await fresh(page);
  await page.routeWebSocket(/\/api\/v1\/ws$/, (socket) => {
    const server = socket.connectToServer();
    server.onMessage((message) => {
      const told = JSON.parse(String(message));
      socket.send(JSON.stringify(speed && told.data?.speed ? { ...told, data: { ...told.data, speed } } : told));
    });
  });
  await open("/", WIDE);
  await tile("demo/alpha").locator(".tile-f", { hasText: /\d s ago, real time/ }).waitFor();
  await page.locator("th", { hasText: /^Age, real time$/ }).waitFor();
  await open("/t/demo/alpha", WIDE);
  await page.locator('[data-testid="command"]', { hasText: /ends in \d+ s, real time/ }).waitFor();
  for (const card of ["devices", "safety"]) await page.locator(`[data-testid="${card}"] th`, { hasText: /^Age, real time$/ }).waitFor();
  // Begun at 02:22:34 and exposed for 120 s, seen at 02:28 and later: by the sky's clock, though its frame has just been announced.
  await page.locator('[data-testid="image-age"]', { hasText: /^02:22:34, ([3-9]|\d\d) min \d+ s ago$|^02:22:34, \d+ h/ }).waitFor();
  speed = null;
  await fresh(page);
  await open("/", WIDE);
  await tile("demo/alpha").locator(".tile-f", { hasText: /^\s*\d s ago/ }).waitFor();
  assert.equal(await page.locator("main", { hasText: "real time" }).count(), 0, "nothing of it where the sky's time is everybody's");
});

test("names of the bus are words for people, with the name as title", TEST, async () => {
  await open("/t/demo/alpha", WIDE);
  await page.locator('[data-testid="safety"] [title="safetymonitor/monitor"]', { hasText: /^Safety monitor$/ }).waitFor();
  await page.locator('[data-testid="command"]', { hasText: "In command is the observatory node of alpha" }).waitFor();
  await page.locator('[data-testid="command"] [title="observatory/alpha/main, token 1, granted by dome/dome"]').waitFor();
  await page.locator('[data-testid="frames-card"]', { hasText: /Not yet archived/ }).waitFor();
  assert.doesNotMatch(await text(page.locator("main")), /token|permit|lease|nobody knows|To archive/);
  const monitor = { input: "safetymonitor/monitor", why: "it says unsafe" };
  const safety = recorded["demo/alpha/observatory/safety/state"];
  await bus.put({ "ridge/gamma/observatory/safety/state": { ...safety, verdict: "unsafe", reasons: [monitor], time_to_safe_s: null } });
  await page.locator('[data-testid="rail-telescope"]', { hasText: /gamma\s*waits for safety monitor/ }).waitFor();
  await open("/t/ridge/gamma", WIDE);
  await page.locator('[data-testid="reasons"] li', { hasText: "when it can clear is not known" }).waitFor();
});

test("an alert whose cause went away calls nobody on the page of its telescope, and says so", TEST, async () => {
  const gone = { id: "device-lost/telescope/mount", priority: "high", cause: "telescope/mount does not answer", consequence: "Rows wait.", action: "Look at its server.", raised_utc: "2026-11-27T01:50:00Z", returned_utc: "2026-11-27T02:10:00Z" };
  await bus.put({ "demo/beta/observatory/alerts/state": { alerts: [gone] } });
  await open("/t/demo/beta", WIDE);
  const note = page.locator(`[data-testid="now"] [data-alert="${gone.id}"]`);
  await note.getByText(/its cause went away at 02:10:00/).waitFor();
  await becomes(() => note.locator(".pri.off").count(), 1);
  assert.doesNotMatch(await note.getAttribute("class"), /p[1-4]/);
  assert.doesNotMatch(await text(note), /Look at its server/);
});
