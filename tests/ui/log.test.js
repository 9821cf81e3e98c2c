// The log: live, searched by text, level and node, and the lines around a moment; what is looked for stands in the address.
import { test } from "node:test";
import assert from "node:assert/strict";
import { TEST, addressOf, becomes, newPage, settled, startRecorded, withBrowser } from "./browser.js";

const [bus, browser] = await withBrowser(startRecorded());
const page = await newPage(browser, { viewport: { width: 1280, height: 900 } });

const lines = () => page.locator('[data-testid="lines"] li').evaluateAll((all) => all.map((one) => ({ level: one.dataset.l, text: one.textContent })));

/** Waits until all lines meet a condition, and there are some. */
const until = (met, told) => becomes(lines, (found) => found.length && found.every(met), told);

test("live lines are filtered by text and level, and a new one comes by itself", TEST, async () => {
  await page.goto(`${bus.url}/t/demo/alpha/log`);
  await settled(page);
  await page.locator('[data-testid="lines"] li').first().waitFor();
  await bus.events([["demo/alpha/node/device/main/diary", { level: "warn", target: "dome", message: "the shutter is slow", fields: { took_s: "61" } }]]);
  await page.locator('[data-testid="lines"] li[data-l="warn"]', { hasText: "the shutter is slow" }).waitFor();
  await page.getByLabel("Search the log").fill("shutter");
  await until(({ text }) => /shutter/.test(text), "only lines with the text");
  await page.getByRole("button", { name: "Warn and up" }).click();
  await until(({ level, text }) => ["warn", "error"].includes(level) && /shutter/.test(text), "only warnings");
  await becomes(() => addressOf(page), { pathname: "/t/demo/alpha/log", text: "shutter", level: "warn" });
  await page.reload();
  await settled(page);
  await until(({ text }) => /shutter/.test(text), "the address keeps what is looked for");
});

test("the archive is searched by text, level and node, for one telescope and for all", TEST, async () => {
  for (const address of ["/t/demo/alpha/log?view=search", "/log?view=search"]) {
    await page.goto(bus.url + address);
    await settled(page);
    const word = "stored";
    await becomes(lines, (all) => all.some(({ text }) => text.includes(word)) && !all.every(({ text }) => text.includes(word)), "the recording has lines with the word, and others");
    await page.getByLabel("Search the log").fill(word);
    await until(({ text }) => text.includes(word), "only lines with the text");
    await page.getByLabel("Search the log").fill("");
    await page.getByLabel("Node", { exact: true }).selectOption("observatory/main");
    await until(({ text }) => text.includes("observatory/main"), "only lines of the node");
    const everyLevel = page.waitForResponse((response) => /\/log\?/.test(response.url()) && !/level=info/.test(response.url()));
    await page.getByRole("button", { name: "All", exact: true }).click();
    assert.equal((await everyLevel).status(), 200, (await everyLevel).url());
    await page.getByRole("button", { name: "Info and up" }).click();
    await page.getByLabel("Node", { exact: true }).selectOption("");
  }
});

test("what was written while the link was cut and is lost leaves a line in its place, which no condition hides", TEST, async () => {
  const cut = await newPage(browser, { viewport: { width: 1280, height: 900 } });
  let says;
  await cut.routeWebSocket(/\/api\/v1\/ws/, (socket) => {
    socket.connectToServer().onMessage((text) => socket.send(text));
    says = (op, data) => socket.send(JSON.stringify({ op, topic: "log?telescope=demo/alpha", data }));
  });
  await cut.goto(`${bus.url}/t/demo/alpha/log`);
  await settled(cut);
  const texts = () => cut.locator('[data-testid="lines"] li[data-l]').allTextContents();
  await becomes(texts, (all) => all.length > 1);
  says("gap", { from: 1, to: 2 });
  says("event", [{ at_utc: "2026-11-27T23:59:59.000000Z", level: "error", node: "observatory/main", telescope: "demo/alpha", number: 1, message: "the link is back", fields: {} }]);
  const where = (all) => [/the link is back/, /Lines are missing here; the archive has them\./].map((text) => all.findIndex((line) => text.test(line)));
  await becomes(texts, (all) => { const [back, hole] = where(all); return back === 0 && hole > back && hole < all.length - 1; }, "above what was known before, below what came then");
  await cut.getByRole("button", { name: "Error", exact: true }).click();
  await cut.getByLabel("Search the log").fill("the link is");
  await becomes(texts, (all) => all.length === 2 && where(all).join() === "0,1", "the line and the hole");
  await cut.close();
});

test("a line leads to the lines around it", TEST, async () => {
  await page.goto(`${bus.url}/log`);
  await settled(page);
  await page.locator('[data-testid="lines"] li a').first().click();
  await page.getByRole("button", { name: "± 10 min" }).click();
  await until(() => true, "lines around the moment");
  await becomes(() => Boolean(addressOf(page).at), true);
  await page.getByRole("link", { name: "Live", exact: true }).click();
  await page.locator('h2:has-text("Live")').waitFor();
});
