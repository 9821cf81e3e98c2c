// The network page with fifty telescopes, in cards, in lines and as a table: worst first, nothing covers anything else, and a second that
// passes draws ages and nothing else.
import { test, beforeEach, afterEach } from "node:test";
import assert from "node:assert/strict";
import { serveFifty } from "./fifty.js";
import { TEST, becomes, drawnBy, fresh, least, looks, newPage, problemsOf, startAlone, tooWide, withBrowser } from "./browser.js";

const [alone, browser] = await withBrowser(startAlone());
const page = await newPage(browser);
const problems = problemsOf(page);
let server;

beforeEach(async () => {
  await fresh(page, { viewport: { width: 1280, height: 900 }, problems });
  server = await serveFifty(page);
  await page.goto(alone.url);
  await page.locator('[data-testid="tile"]').nth(49).waitFor();
}, TEST);

afterEach(() => server?.end());

const WORST = ["san-pedro/taygete", "paranal/ananke31", "sutherland/amalthea44"];
const ids = (selector, name) => page.locator(selector).evaluateAll((all, attribute) => all.map((one) => one.getAttribute(attribute)), name);
const tiles = () => ids('[data-testid="tile"]', "data-telescope");
const rows = () => ids('[data-testid="row"]', "data-of");
async function press(name) {
  await page.getByRole("button", { name, exact: true }).click();
  await page.getByRole("button", { name, exact: true, pressed: true }).waitFor();
}

/** As [`drawnBy`], of this page. */
const drawn = (id, change) => drawnBy(page, id, change);

test("worst first in tiles, night and table; only those that need somebody are whole cards", TEST, async () => {
  for (const all of [tiles, rows]) {
    await becomes(async () => (await all()).slice(0, 3), WORST);
    await becomes(async () => new Set(await all()).size, 50);
  }
  await page.locator('[data-testid="nights"]').scrollIntoViewIfNeeded();
  await page.locator('[data-testid="night-line"]').nth(49).waitFor();
  await becomes(async () => (await ids('[data-testid="night-line"]', "data-of")).slice(0, 3), WORST);
  const heights = await page.locator('[data-testid="tile"]').evaluateAll((all) => all.map((one) => one.getBoundingClientRect().height));
  assert.ok(heights.slice(0, 3).every((height) => height > 150) && heights.slice(3).every((height) => height < 60), String(heights));
  await press("Need you 3");
  await becomes(tiles, WORST);
  await page.locator('[data-testid="lede"]', { hasText: /^taygete, ananke31 need you now\. amalthea44 needs you later tonight\./ }).waitFor();
});

test("in no view and at no width does a part cover another, and the page does not scroll sideways", TEST, async () => {
  for (const width of [1280, 1024, 768, 390, 320]) {
    await page.setViewportSize({ width, height: 900 });
    for (const view of ["Cards", "Compact"]) {
      await press(view);
      const bad = await page.locator('[data-testid="tile"]').evaluateAll((all) => all.flatMap((one) => {
        const name = one.getAttribute("data-telescope");
        const box = (part) => one.querySelector(part)?.getBoundingClientRect();
        const outer = one.getBoundingClientRect();
        const parts = [".tile-h b", ".what", ".thumb", ".expected", ".btn", ".stats"].map((part) => [part, box(part)]).filter(([, found]) => found?.width);
        const found = parts.filter(([, at]) => at.left < outer.left || at.right > outer.right + 0.5 || at.bottom > outer.bottom + 0.5 || at.top < outer.top - 0.5).map(([part]) => `${name}: ${part} leaves its tile`);
        for (const [i, [first, a]] of parts.entries()) for (const [second, b] of parts.slice(i + 1)) if (a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1) found.push(`${name}: ${first} covers ${second}`);
        return found;
      }));
      assert.deepEqual(bad, [], `${view} at ${width}`);
      assert.equal(await tooWide(page), null, `${view} at ${width}`);
    }
    if (width === 1280 || width === 390) assert.equal(await page.locator(".tw", { has: page.locator('[data-testid="row"]') }).evaluate((one) => one.scrollWidth <= one.clientWidth), true, `the whole table is seen at ${width}`);
  }
});

test("a second that passes draws ages; what one telescope does draws its own parts", TEST, async () => {
  await page.locator('[data-testid="nights"]').scrollIntoViewIfNeeded();
  await page.locator('[data-testid="night-line"]').nth(49).waitFor();
  // The step of ten seconds and a page that is just coming are no seconds: the least of some.
  const seconds = [];
  for (let i = 0; i < 4; i += 1) seconds.push(await drawn());
  assert.equal(least(seconds, "Age"), 100, "each tile and each row has an age");
  for (const name of ["Tile", "Row", "Table", "All", "Line", "Nights", "Network", "Rail", "Lede"]) assert.equal(least(seconds, name), 0, name);
  const [id] = WORST;
  const tile = page.locator(`[data-testid="tile"][data-telescope="${id}"]`);
  const changes = [];
  for (let i = 0; i < 4; i += 1) changes.push(await drawn(id, { frames: 9996 + i }));
  assert.deepEqual([least(changes, "Tile"), least(changes, "Row")], [1, 1]);
  await tile.getByText("9999").waitFor();
});

test("a telescope that falls silent is told without a message of it, and the others stay", TEST, async () => {
  const [, , third] = WORST;
  server.silent.add("teide/callisto43");
  await page.locator('[data-testid="tile"][data-telescope="teide/callisto43"][data-quality="lost"]').waitFor();
  await page.locator('[data-testid="row"][data-of="teide/callisto43"][data-quality="lost"]').waitFor();
  await becomes(tiles, (all) => all.indexOf("teide/callisto43") < all.indexOf(third), "it needs somebody more than what is medium");
  await becomes(() => page.locator('[data-testid="tile"][data-quality="fresh"]').count(), 49);
  server.silent.clear();
  await page.locator('[data-testid="tile"][data-telescope="teide/callisto43"][data-quality="fresh"]').waitFor();
});

test("by keyboard: the worst comes first, the focus stays where it is when another comes to the front, and the table is filtered and sorted", TEST, async () => {
  const close = page.locator('[data-testid="tile"][data-telescope="paranal/elara"]').getByRole("button");
  await close.focus();
  const elara = server.told.get("la-silla/metis");
  server.tell({ ...elara, concern: "critical", alerts: [{ ...server.told.get(WORST[0]).alerts[0], id: "another" }] });
  await page.waitForFunction(() => document.querySelector('[data-testid="tile"]').dataset.telescope === "la-silla/metis");
  await becomes(() => close.evaluate((one) => document.activeElement === one), true, "the focus stays");
  await page.locator('.seg [aria-pressed="true"]', { hasText: "Compact" }).focus();
  await page.keyboard.press("Tab");
  await becomes(() => page.evaluate(() => document.activeElement.closest("[data-telescope]")?.dataset.telescope), "la-silla/metis");
  await page.keyboard.press("/");
  await page.keyboard.type("trappist");
  const expected = [...server.told.values()].filter(({ id, activity }) => /trappist/i.test(id + activity[0]?.object)).length;
  const shown = await becomes(rows, (all) => all.length === expected, `${expected} rows are left`);
  await page.getByRole("button", { name: "Telescope", exact: true }).focus();
  await page.keyboard.press("Enter");
  const name = (id) => id.split("/")[1];
  await becomes(async () => (await rows()).map(name), shown.map(name).sort());
});

test("the server takes no more topics: what is opened takes the place of what was left, and what was refused comes when there is room", TEST, async () => {
  const open = async () => {
    await page.goto(`${alone.url}/alerts`);
    await page.locator('body[data-link="live"]').waitFor();
    await becomes(() => server.topics().includes("alerts"), true);
    await page.evaluate(async () => {
      const [{ html, render, signal }, { useTopic }] = await Promise.all([import("/assets/lib.js"), import("/assets/store.js")]);
      const One = ({ name }) => html`<li data-topic=${name} data-has=${String(useTopic(name) !== null)}></li>`;
      const All = () => html`<ul>${window.wanted.value.map((name) => html`<${One} key=${name} name=${name} />`)}</ul>`;
      window.wanted = signal([]);
      render(html`<${All} />`, document.body.appendChild(document.createElement("div")));
    });
  };
  const want = (names) => page.evaluate((wanted) => { window.wanted.value = wanted; }, names);
  const has = () => page.locator('[data-topic][data-has="true"]').evaluateAll((all) => all.map((one) => one.dataset.topic));
  const of = (from, count) => [...server.told.keys()].slice(from, from + count).map((id) => `tel/${id}/device/dome`);
  await open();
  const own = server.topics();
  server.limits.topics = own.length + 8;
  await open();
  await want(of(0, 12));
  await becomes(() => server.refusals.length, 4);
  const [one, two, three, ...others] = await becomes(has, (all) => all.length === 8);
  await want(of(0, 12).filter((name) => ![one, two, three].includes(name)));
  await becomes(async () => (await has()).filter((name) => !others.includes(name)).length, 3, "three have left, and three of those that were refused come");
  await want(of(20, 8));
  await becomes(has, of(20, 8), "all that is opened");
  await becomes(() => server.topics().sort(), [...own, ...of(20, 8)].sort());
  assert.equal(server.refusals.length, 4, "nothing was asked for without room for it");
  assert.deepEqual(problems.filter((one) => /topics/.test(one)), []);
});

test("images that the view hides are not asked for", TEST, async () => {
  await page.locator('[data-testid="tile"] .thumb img').nth(2).waitFor();
  await becomes(() => [...server.images].sort(), [...WORST].sort());
  await press("Cards");
  await page.locator('[data-testid="tile"] .thumb img').nth(49).waitFor();
  await becomes(() => new Set(server.images).size, 50);
});

test("fifty telescopes have no serious finding of axe-core in three themes at two widths", TEST, async () => {
  const found = await looks(page, "compact");
  await press("Cards");
  await page.setViewportSize({ width: 1280, height: 900 });
  found.push(...(await looks(page, "cards")));
  assert.deepEqual(found, []);
  assert.deepEqual(problems, []);
});
