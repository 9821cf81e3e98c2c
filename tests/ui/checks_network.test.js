// Numbered checks of the network, phones, the log and nodes that no other file proves; checks/network.md says which test proves which. Alerts are in checks_alerts.test.js.
import { test } from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { network } from "./recorded/network.js";
import { TEST, addressOf, becomes, boxOf, chooseTheme, everyAddress, follow, newPage, settled, tooWide } from "./browser.js";
import { ALPHA, COPIES, WIDE, browser, bus, calm, copy, open, page, problems, recorded, stuck, tell } from "./six.js";

const TALL = { width: 1280, height: 1600 };
const PHONE = { width: 390, height: 844 };
const SIX = [ALPHA, ...COPIES];
/** Figures that are counted, and have no unit. */
const COUNTED = new Set(["Rows", "Frames", "Stars", "Not readable"]);

const mark = () => page.evaluate(() => { Object.assign(window, { isSame: true }); });
const isMarked = () => page.evaluate(() => "isSame" in window);

const tile = (id) => page.locator(`[data-testid="tile"][data-telescope="${id}"]`);
const tiles = () => page.locator('[data-testid="tile"]').evaluateAll((all) => all.map((one) => one.dataset.telescope));
/** What the tiles say of themselves, by telescope. */
const faces = () => page.locator('[data-testid="tile"]').evaluateAll((all) => Object.fromEntries(all.map(({ dataset: { telescope, safety, posture, mode, quality, level = "" } }) => [telescope, [safety, posture, mode, quality, level].join(" ").trim()])));

/** Pixels of a hue that stands for an alert of somebody: of the whole page outside of some boxes, and in each of these. */
async function alarming(boxes = []) {
  const shot = await page.screenshot();
  return page.evaluate(async ([data, inside]) => {
    const image = await createImageBitmap(new Blob([Uint8Array.from(atob(data), (c) => c.charCodeAt(0))]));
    const context = new OffscreenCanvas(image.width, image.height).getContext("2d");
    context.drawImage(image, 0, 0);
    const { data: pixels } = context.getImageData(0, 0, image.width, image.height);
    const found = { outside: 0, inside: inside.map(() => 0), first: "" };
    for (let i = 0; i < pixels.length; i += 4) {
      // Red, or amber to yellow; a mix with the ground around a letter may be pale.
      const [r, g, b] = pixels.subarray(i, i + 3);
      const chroma = r - Math.min(g, b);
      const hue = (60 * (g - b)) / chroma;
      if (r < Math.max(g, b) || chroma < 60 || hue < -18 || hue > 62) continue;
      const [x, y] = [(i / 4) % image.width, Math.floor(i / 4 / image.width)];
      const at = inside.findIndex((box) => x >= box.x - 2 && x <= box.x + box.width + 2 && y >= box.y - 2 && y <= box.y + box.height + 2);
      if (at >= 0) found.inside[at] += 1;
      else { found.outside += 1; found.first ||= `${x}, ${y}: rgb(${r}, ${g}, ${b}) ${document.elementFromPoint(x, y)?.outerHTML.slice(0, 160)}`; }
    }
    return found;
  }, /** @type {const} */ ([shot.toString("base64"), boxes]));
}

test("each of six telescopes has a tile with safety, dome and mode, and on a phone they stand in one column", TEST, async () => {
  await becomes(faces, Object.fromEntries(SIX.map((id) => [id, "safe open robotic fresh"])));
  await open("/", PHONE);
  await becomes(() => page.locator('[data-testid="tile"]').evaluateAll((all) => new Set(all.map((one) => Math.round(one.getBoundingClientRect().x))).size), 1, "columns");
  assert.equal(await tooWide(page), null);
});

test("nothing of a network that is well has the hue of an alert, and in a storm only what belongs to who is in it", TEST, async () => {
  for (const address of ["/t/demo/alpha", "/"]) {
    await open(address, TALL);
    for (const theme of ["light", "dark"]) {
      await chooseTheme(page, theme);
      await becomes(alarming, (found) => found.outside === 0, `${address} in the theme ${theme}`);
    }
  }
  await network({ ...bus, states: async () => recorded });
  await tile("ridge/delta").and(page.locator('[data-level="p1"]')).waitFor();
  await tile("demo/beta").and(page.locator('[data-level="p3"]')).waitFor();
  await page.locator('[data-testid="site"][aria-label="ridge"] .over').first().waitFor();
  const of = ["demo/beta", "ridge/delta", "ridge/gamma"];
  const parts = of.flatMap((id) => [`[data-telescope="${id}"]`, `[data-of="${id}"]`, `.rail [href="/t/${id}"]`]);
  const affected = [...parts, '[data-testid="banner"]', ".counts", '[data-testid="site"][aria-label="ridge"]'].join();
  for (const theme of ["light", "dark"]) {
    await chooseTheme(page, theme);
    await becomes(async () => alarming(await page.locator(affected).evaluateAll((all) => all.map((one) => one.getBoundingClientRect().toJSON()))), ({ outside, inside }) => outside === 0 && inside.some((n) => n > 100), `a storm in the theme ${theme}`);
  }
  await calm();
  await becomes(faces, (all) => Object.values(all).every((face) => face === "safe open robotic fresh"));
});

test("a telescope that is open while its sky is unsafe comes first, and no other changes", TEST, async () => {
  await open("/");
  const before = await faces();
  const key = "ridge/gamma/observatory/safety/state";
  await bus.put({ [key]: { ...copy("ridge/gamma")[key], verdict: "unsafe", since_utc: "2026-11-27T02:18:00.000000Z", reasons: [{ input: "safetymonitor/monitor", why: "it says unsafe", clears_in_s: null }] } });
  await becomes(faces, { ...before, "ridge/gamma": "unsafe open robotic fresh p1" });
  await becomes(async () => (await tiles())[0], "ridge/gamma");
  await calm(["ridge/gamma"]);
  await becomes(faces, before);
});

test("tiles are sorted by what somebody is needed for, then what is old, what works, what waits, and by name", TEST, async () => {
  await open("/");
  const order = () => page.evaluate(async () => {
    const { net } = await import("/assets/store.js");
    const { elapsed } = await import("/assets/elapsed.js");
    /** @type {any} */ (window).own ??= net.value;
    const changes = { "ridge/zeta": { concern: "critical" }, "ridge/epsilon": { concern: "high" }, "ridge/gamma": { concern: "medium" }, "ridge/delta": { age_s: 8 }, "demo/alpha": { activity: [] } };
    net.value = new Map([...net.value].map(([id, summary]) => [id, { ...summary, ...changes[id], received: elapsed() }]));
    await new Promise((resolve) => { requestAnimationFrame(() => setTimeout(resolve)); });
    return [...document.querySelectorAll('[data-testid="tile"]')].map((one) => /** @type {any} */ (one).dataset.telescope);
  });
  await becomes(order, ["ridge/zeta", "ridge/epsilon", "ridge/gamma", "ridge/delta", "demo/beta", ALPHA]);
  await page.evaluate(() => import("/assets/store.js").then(({ net }) => { net.value = /** @type {any} */ (window).own; }));
});

/** The page of another person, who watches one telescope that falls silent while the other tests go on. */
const other = await newPage(browser, { viewport: WIDE });

test("a telescope says nothing more", TEST, async () => {
  await follow(other, bus.url);
  await other.locator('[data-testid="tile"][data-telescope="ridge/zeta"][data-quality="fresh"]').waitFor();
  await other.evaluate(() => {
    const zeta = /** @type {any} */ (document.querySelector('[data-testid="tile"][data-telescope="ridge/zeta"]'));
    const seen = [zeta.dataset.quality];
    new MutationObserver(() => seen.push(zeta.dataset.quality)).observe(zeta, { attributeFilter: ["data-quality"] });
    Object.assign(window, { seen, kept: zeta });
  });
  await bus.put(Object.fromEntries(Object.keys(copy("ridge/zeta")).map((key) => [key, null])));
});

test("every page fits 320 px, its end is above the bars, its figures have units, and a critical alert is told on all of them by the same words, once", TEST, async () => {
  await tell("ridge/delta", stuck);
  await open("/alerts", { width: 320, height: 720 });
  await mark();
  const banner = page.locator('[data-testid="banner"][role="alert"]');
  await banner.getByText("delta: It is half open.").waitFor();
  await page.evaluate(() => {
    const said = document.querySelector('[data-testid="banner"]');
    const again = [];
    new MutationObserver((list) => again.push(...list.map((one) => one.type))).observe(said.querySelector("p"), { childList: true, characterData: true, subtree: true });
    Object.assign(window, { said, again });
  });
  const found = [];
  for (const address of await everyAddress(page)) {
    await follow(page, bus.url + address);
    const wide = await tooWide(page);
    if (wide) found.push(`${address}: ${wide}`);
    const told = await becomes(() => page.evaluate(async () => {
      scrollTo(0, document.documentElement.scrollHeight);
      await new Promise((resolve) => { requestAnimationFrame(() => setTimeout(resolve)); });
      const bars = [...document.querySelectorAll("nav.bottom, .dock")].map((bar) => bar.getBoundingClientRect()).filter((box) => box.height);
      const end = document.querySelector(".col").getBoundingClientRect().bottom;
      const { said, again } = /** @type {any} */ (window);
      const bare = [...document.querySelectorAll(".stat")].filter((one) => /^[\d.\u2212/]+$/.test(one.querySelector("dd b").textContent) && one.querySelector("dd").childNodes.length < 2).map((one) => one.querySelector("dt").textContent);
      return { bare, bars: bars.length, covered: Math.round(end - Math.min(...bars.map((box) => box.top))), same: document.querySelector('[data-testid="banner"]') === said, alerts: [...document.querySelectorAll('[role="alert"]')].filter((one) => one.checkVisibility()).length, again: again.length };
    }), ({ covered }) => covered <= 0, `${address}: the bars cover its end`);
    found.push(...told.bare.filter((name) => !COUNTED.has(name)).map((name) => `${address}: ${name} has no unit`));
    if (!told.bars) found.push(`${address}: no bar`);
    if (!told.same || told.alerts !== 1 || told.again) found.push(`${address}: the alert is told again ${JSON.stringify(told)}`);
  }
  assert.deepEqual(found, []);
  assert.equal(await isMarked(), true);
  await tell("ridge/delta");
});

test("turned to its side a phone keeps what was typed, what is open and the page", TEST, async () => {
  await open("/t/demo/alpha/log", PHONE);
  await mark();
  const search = page.getByLabel("Search the log");
  await search.fill("row");
  await page.locator('[data-testid="close"]:visible').first().click();
  for (const size of [{ width: 844, height: 390 }, PHONE]) {
    await page.setViewportSize(size);
    await becomes(() => boxOf(page.locator('[data-testid="close-now"]:focus')), ({ y, height }) => y >= 0 && y + height <= size.height, `${size.width} px: Close now is in view`);
  }
  await page.keyboard.press("Escape");
  await becomes(() => search.inputValue(), "row");
  assert.deepEqual([await isMarked(), addressOf(page)], [true, { pathname: "/t/demo/alpha/log", text: "row" }]);
});

test("an address keeps what was chosen, through a reload, back and forward", TEST, async () => {
  const pressed = () => page.locator('main [aria-pressed="true"]').evaluateAll((all) => all.map((one) => one.textContent.replace(/ \d+$/, "")));
  await page.setViewportSize(WIDE);
  const choices = {
    "/?show=open&view=compact&filter=alp": async () => { await becomes(pressed, ["Open", "Compact"]); await becomes(() => page.getByLabel("Filter telescopes").inputValue(), "alp"); await becomes(() => page.locator('[data-testid="row"]').count(), 1); },
    "/t/demo/alpha/weather?hours=24&from=2026-11-27T01%3A00%3A00Z&to=2026-11-27T02%3A00%3A00Z": async () => {
      await becomes(pressed, ["24 h"]);
      await becomes(() => page.locator('[data-testid="chart"]').evaluateAll((all) => all.map(({ dataset }) => [dataset.from, dataset.to].map((ms) => new Date(Number(ms)).toISOString().slice(11, 19)).join())), ["01:00:00,02:00:00"]);
    },
    "/alerts?least=high": () => becomes(pressed, ["High and up"]),
    "/t/demo/alpha/guiding?hours=12&unit=arcsec": () => becomes(pressed, ["″", "12 h"]),
    "/t/demo/alpha/devices/focuser/focuser?history=Position&hours=1": async () => { await becomes(pressed, ["1 h"]); await page.getByRole("heading", { name: "Position, the past" }).waitFor(); },
    "/t/demo/alpha/frames?view=list": () => becomes(pressed, ["List"]),
    "/nodes?role=archive": () => becomes(pressed, ["Archive"]),
    "/log?view=search&hours=24&to=2026-11-27T02%3A20%3A00.000Z&level=warn&text=row&telescope=demo%2Falpha&node=observatory%2Fmain": async () => {
      await becomes(pressed, ["Archive", "Warn and up", "24 h"]);
      const typed = () => Promise.all(["Search the log", "Node", "Telescope", /^Until/].map((label) => page.getByLabel(label, typeof label === "string" ? { exact: true } : {}).inputValue()));
      await becomes(typed, ["row", "observatory/main", "demo/alpha", "2026-11-27 02:20:00"]);
    },
    "/t/demo/alpha/log?at=2026-11-27T02%3A20%3A00Z&around_s=600": async () => { await becomes(pressed, (all) => all.includes("± 10 min")); await page.getByText("Around 27 Nov 02:20:00").waitFor(); },
  };
  const all = Object.entries(choices);
  for (const [address, holds] of all) {
    await open(address);
    await holds();
  }
  for (const [, holds] of all.slice(0, -1).reverse()) {
    await page.goBack();
    await holds();
  }
  for (const [step, [, holds]] of /** @type {[Function, any][]} */ ([[() => page.goForward(), all[1]], [() => page.reload(), all[1]], [() => page.goBack(), all[0]]])) {
    await step();
    await holds();
  }
  await page.getByRole("button", { name: "All 6", exact: true }).click();
  await page.getByRole("button", { name: "Cards", exact: true }).click();
  await page.getByLabel("Filter telescopes").fill("");
  await becomes(() => addressOf(page), { pathname: "/", view: "cards" });
});

test("whoever opens a telescope from the keyboard and goes back finds the place and the order again", TEST, async () => {
  await open("/", { width: 1280, height: 500 });
  for (let i = 0; i < 2; i += 1) await page.getByRole("columnheader", { name: "Telescope" }).getByRole("button").click();
  const sorted = () => becomes(() => page.locator('[data-testid="row"]').evaluateAll((all) => all.map((one) => one.dataset.of)), ["ridge/zeta", "ridge/gamma", "ridge/epsilon", "ridge/delta", "demo/beta", ALPHA]);
  await sorted();
  const opened = page.locator('[data-testid="row"][data-of="demo/alpha"] a');
  await opened.focus();
  assert.ok(await page.evaluate(() => scrollY) > 300, "it is further down");
  await page.keyboard.press("Enter");
  await page.waitForURL(/\/t\/demo\/alpha$/);
  await page.locator('[data-testid="devices"]').waitFor();
  await becomes(() => page.evaluate(() => scrollY), 0);
  await page.goBack();
  await sorted();
  // What is above it may be higher or lower by now.
  await becomes(() => opened.evaluate((one) => one.getBoundingClientRect().top), (top) => top > -200 && top < 700, "it is about where it was");
});

const line = (message) => ["demo/alpha/node/device/main/diary", { level: "info", target: "dome", message, fields: { took_s: "61" } }];
const lines = (on) => on.locator('[data-testid="lines"] li[data-l]');

test("lines that come while somebody reads further down move nothing, and a line is copied with its time", TEST, async () => {
  await open("/t/demo/alpha/log", { width: 1280, height: 500 });
  await lines(page).nth(30).waitFor();
  const read = await lines(page).nth(20).elementHandle();
  await page.evaluate(() => { document.querySelector("ul.log").scrollTop = 300; });
  const top = () => read.evaluate((one) => Math.round(one.getBoundingClientRect().top));
  const before = await top();
  await bus.events([line("the first of three"), line("the second of three"), line("the third of three")]);
  await lines(page).filter({ hasText: "of three" }).nth(2).waitFor();
  await becomes(top, before, "the line that is read stays where it is");
  const copied = await read.evaluate((one) => { getSelection().selectAllChildren(one); return getSelection().toString(); });
  const message = (await read.evaluate((one) => one.querySelector(".msg").firstChild.textContent)).trim();
  assert.ok(/\d\d:\d\d:\d\d\.\d{3}/.test(copied) && copied.includes(message), `${copied} has the time and ${message}`);
});

/** A browser in another zone, whose clock is wrong, and whose link can be cut. */
const abroad = await newPage(browser, { viewport: WIDE, timezoneId: "Asia/Bangkok" });
const sockets = [];
let isAway = false;
await abroad.routeWebSocket(/\/api\/v1\/ws/, (socket) => {
  if (isAway) return void socket.close();
  socket.connectToServer();
  return void sockets.push(socket);
});

test("a browser whose clock and zone are elsewhere shows the same times and ages, and judges ages as the server does", TEST, async () => {
  await abroad.addInitScript((ahead) => {
    const Own = Date;
    globalThis.Date = /** @type {any} */ (class extends Own {
      constructor(...given) { super(...(/** @type {[any]} */ (given.length ? given : [Own.now() + ahead]))); }
      static now() { return Own.now() + ahead; }
    });
  }, 7 * 3600e3 - 90e3);
  await abroad.goto(`${bus.url}/t/demo/alpha`);
  await settled(abroad);
  await open("/t/demo/alpha");
  const seconds = async (on) => (await on.locator('[data-testid="utc"]').textContent()).split(":").reduce((sum, part) => 60 * sum + Number(part), 0);
  await becomes(async () => Math.abs((await seconds(abroad)) - (await seconds(page))), (apart) => apart < 5, "the same clock");
  await becomes(() => abroad.locator("[data-age-s]").evaluateAll((all) => all.length > 8 && Math.max(...all.map((one) => Number(one.dataset.ageS))) < 60), true, "ages of seconds");
  for (const address of [null, "/t/demo/alpha/log"]) {
    if (address) await follow(abroad, bus.url + address);
    await abroad.locator("time[datetime]").first().waitFor();
    const wrong = await abroad.locator("time[datetime]").evaluateAll((all) => all.filter((one) => !one.dateTime.includes(one.textContent.trim())).map((one) => one.outerHTML));
    assert.deepEqual(wrong, [], "times are those of UTC");
  }
  assert.equal(await abroad.locator('[data-testid="night-name"]').textContent(), await page.locator('[data-testid="night-name"]').textContent());
  const judged = () => page.evaluate(async () => {
    const { quality } = await import("/assets/store.js");
    return [1, 5, 10, 60].map((period) => [Math.max(2 * period, 5), Math.max(5 * period, 15)].flatMap((bound) => [quality(bound - 0.1, period), quality(bound + 0.1, period)]).join(" ")).concat(quality(null, 5), quality(1e9, null));
  });
  await becomes(judged, [...Array(4).fill("fresh stale stale lost"), "lost", "fresh"], "what an age is worth");
});

test("after the link was cut each line is there once, and twenty thousand lines are three hundred rows", TEST, async () => {
  await open("/t/demo/alpha/log");
  await bus.events([line("before the cut 0")]);
  await lines(abroad).filter({ hasText: "before the cut 0" }).waitFor();
  isAway = true;
  await sockets[0].close();
  await abroad.locator('body[data-link="lost"]').waitFor();
  await bus.events(Array.from({ length: 9 }, (_, n) => line(`during the cut ${n}`)));
  await lines(page).filter({ hasText: "during the cut 8" }).waitFor();
  isAway = false;
  await abroad.evaluate(() => dispatchEvent(new Event("online")));
  await lines(abroad).filter({ hasText: "during the cut 8" }).waitFor();
  await bus.events([line("after the cut 0")]);
  await lines(abroad).filter({ hasText: "after the cut 0" }).waitFor();
  const told = await lines(abroad).evaluateAll((all) => all.map((one) => one.textContent.match(/(before|during|after) the cut \d|Lines are missing/)?.[0]).filter(Boolean));
  assert.deepEqual(told, ["after the cut 0", ...Array.from({ length: 9 }, (_, n) => `during the cut ${8 - n}`), "before the cut 0"]);
  for (let part = 0; part < 4; part += 1) {
    const data = Array.from({ length: 5000 }, (_, i) => part * 5000 + i).map((n) => ({ at_utc: new Date(Date.UTC(2026, 10, 27, 4) + n).toISOString(), level: "info", node: "device/main", telescope: ALPHA, number: 1e6 + n, message: `flood ${n}`, fields: {} }));
    sockets.at(-1).send(JSON.stringify({ op: "event", topic: "log?telescope=demo/alpha", data }));
  }
  await lines(abroad).filter({ hasText: "flood 19999" }).waitFor();
  await becomes(() => lines(abroad).count(), 300);
  await abroad.close();
});

test("Tab reaches everything that can be used, in the order in which it stands, and shows where it is", TEST, async () => {
  for (const address of ["/t/demo/alpha/controls", "/t/demo/alpha/frames", "/"]) {
    await open(address);
    await becomes(() => page.locator("main :is(a, button):visible").count(), (n) => n > 5, "what can be used is there");
    const count = await page.evaluate(() => {
      const wanted = /** @type {any[]} */ ([...document.querySelectorAll('a[href], button, input, select, textarea, summary, [tabindex="0"]')].filter((one) => !one.matches(":disabled, [tabindex='-1']") && one.checkVisibility({ visibilityProperty: true }) && one.getClientRects().length));
      const reached = [];
      const ringless = new Set();
      addEventListener("focusin", ({ target }) => {
        reached.push(target);
        const rings = [target, target.closest(".in"), ...target.querySelectorAll("*")].filter(Boolean).map((one) => getComputedStyle(one));
        if (!rings.some((one) => one.outlineStyle !== "none" && parseFloat(one.outlineWidth) >= 2)) ringless.add(target.outerHTML.slice(0, 120));
      });
      Object.assign(window, { wanted, reached, ringless });
      return wanted[0].focus() ?? wanted.length;
    });
    for (let i = 0; i < count + 30; i += 1) await page.keyboard.press("Tab");
    const found = await page.evaluate(() => {
      const { wanted, reached, ringless } = /** @type {any} */ (window);
      const name = (one) => `${one.tagName} ${one.getAttribute("class")} ${(one.getAttribute("aria-label") ?? one.textContent).slice(0, 60)}`;
      const order = wanted.filter((one) => reached.includes(one)).slice(1).sort((a, b) => reached.indexOf(a) - reached.indexOf(b));
      /** Of two that follow each other: the parts of the page, side by side, that they are in. */
      const apart = (a, b) => { for (let up = a; up; up = up.parentElement) if (up.parentElement?.contains(b)) return [up, [...up.parentElement.children].find((one) => one.contains(b))].map((one) => one.getBoundingClientRect()); return null; };
      const back = order.slice(1).filter((one, i) => {
        const boxes = order[i].contains(one) ? null : apart(order[i], one);
        return boxes && (boxes[1].bottom <= boxes[0].top || (boxes[1].right <= boxes[0].left && boxes[1].top < boxes[0].bottom));
      });
      return { missed: wanted.filter((one) => one.isConnected && !reached.includes(one)).map(name), ringless: [...ringless], back: back.map(name) };
    });
    assert.deepEqual(found, { missed: [], ringless: [], back: [] }, address);
  }
  for (const what of [page.locator(".rail .nav").nth(1), tile("demo/beta").locator("a").first(), tile("demo/beta").getByRole("button"), page.locator(".chip").first(), page.locator("th button").first(), page.getByLabel("Filter telescopes")]) {
    await what.scrollIntoViewIfNeeded();
    // The ring of a field is around its frame.
    const { x, y, width } = await what.evaluate((one) => (one.closest(".in") ?? one).getBoundingClientRect().toJSON());
    const clip = { x: Math.max(0, x - 6), y: y - 8, width: Math.min(width, 40) + 12, height: 12 };
    const plain = await page.screenshot({ clip });
    await what.focus();
    assert.notEqual(Buffer.compare(plain, await page.screenshot({ clip })), 0, `${what} shows that it has the focus`);
    await what.blur();
  }
});

test("a new frame changes the picture of a tile once, and nothing asks for it again", TEST, async () => {
  await open("/");
  const picture = tile(ALPHA).locator("img");
  const asked = [];
  page.on("request", (request) => { if (/demo\/alpha\/image\.jpg/.test(request.url())) asked.push(request.url()); });
  const { body } = JSON.parse(readFileSync(join(import.meta.dirname, "recorded/bus.jsonl"), "utf8").split("\n").findLast((text) => text.includes('/camera/frame"')));
  const frame = "01a218a1-ffff-7476-83d3-56cf993d96d8";
  await picture.evaluate((image) => {
    const changes = [];
    new MutationObserver((list) => changes.push(...list)).observe(image.parentElement, { subtree: true, childList: true, attributeFilter: ["src"] });
    Object.assign(window, { changes });
  });
  await bus.events([["demo/alpha/device/camera/camera/frame", { ...body, id: frame }]]);
  await tile(ALPHA).locator(`img[data-frame="${frame}"]`).waitFor();
  const seen = new Set();
  await becomes(async () => seen.add(await page.locator('[data-testid="utc"]').textContent()).size, (beats) => beats > 2, "some seconds pass");
  assert.deepEqual([asked.length, await page.evaluate(() => /** @type {any} */ (window).changes.length)], [1, 1]);
  const tag = (await fetch(asked[0])).headers.get("etag");
  assert.equal((await fetch(asked[0], { headers: { "If-None-Match": tag } })).status, 304);
});

test("the silent one was stale and is lost now, without numbers, its nodes are found, and the others are as they were", TEST, async () => {
  const zeta = other.locator('[data-testid="tile"][data-telescope="ridge/zeta"]');
  await other.locator('[data-testid="tile"][data-telescope="ridge/zeta"][data-quality="lost"]').waitFor();
  assert.deepEqual(await other.evaluate(() => /** @type {any} */ (window).seen), ["fresh", "stale", "lost"]);
  assert.equal(await other.evaluate(() => /** @type {any} */ (window).kept.isConnected), true, "it is the same tile, and nothing was loaded again");
  await becomes(() => zeta.locator(".stat dd b").allTextContents(), ["—", "—", "—", "—"]);
  await becomes(() => other.locator('[data-testid="tile"][data-quality="fresh"]').count(), 5);
  await follow(other, `${bus.url}/nodes`);
  await becomes(() => other.locator('[data-testid="node"]:not([data-quality="fresh"])', { hasText: "ridge/zeta" }).count(), 4, "its four nodes");
  await follow(other, `${bus.url}/t/ridge/zeta`);
  await becomes(() => other.locator('[data-testid="device"][data-quality="fresh"]').count(), 0, "and none of its devices is fresh");
  await other.close();
});

test("without its server the page says so, orders nothing but Close, and goes on by itself when it is back", TEST, async () => {
  await open("/t/demo/alpha/controls");
  await mark();
  const orders = page.locator('[data-testid="order"]');
  await becomes(() => orders.locator("button:enabled").count(), (n) => n > 3);
  await bus.stop();
  await page.locator('body[data-link="lost"] [data-testid="link-lost"]', { hasText: /No link to the server since \d\d:\d\d:\d\d/ }).waitFor();
  await becomes(() => page.locator('[data-quality="fresh"], [data-safety="safe"], [data-posture="open"]').count(), 0, "nothing is shown as live");
  await becomes(() => orders.locator("button:enabled").count(), 0);
  await becomes(async () => (await orders.filter({ hasText: "No link to the server: nothing can be ordered." }).count()) === (await orders.count()), true, "each says why");
  assert.ok(await page.locator('[data-testid="close"]:visible').first().isEnabled());
  await bus.again();
  await page.locator('body[data-link="live"]').waitFor();
  await becomes(() => orders.locator("button:enabled").count(), (n) => n > 3);
  await page.locator('.scope [data-safety="safe"][data-posture="open"]').waitFor();
  assert.equal(await isMarked(), true, "it was not loaded again");
  assert.deepEqual(problems.filter((one) => !/Failed to load resource|WebSocket connection|ERR_CONNECTION/.test(one)), []);
});
