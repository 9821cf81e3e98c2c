// Numbered checks of alerts that no other file proves; checks/network.md says which test proves which.
import { test } from "node:test";
import assert from "node:assert/strict";
import { TEST, becomes, newPage, settled } from "./browser.js";
import { WIDE, blurred, browser, bus, open, page, problems, raised, stuck, tell } from "./six.js";

/** The page of another person. */
const other = await newPage(browser, { viewport: WIDE });

test("title and icon of the window have the highest priority that calls for somebody, and what is acknowledged is not in them", TEST, async () => {
  const icons = new Set();
  const icon = async () => { const href = await page.locator('link[rel="icon"]').getAttribute("href"); icons.add(href); return /favicon-?(.*)\.svg$/.exec(href)[1]; };
  const title = async (expected) => becomes(async () => [await page.title(), await icon()], [expected, { "◆": "high", "▲": "critical", "▼": "medium" }[expected[0]] ?? ""]);
  await open("/nodes");
  await title("Nodes – Starmesh");
  await tell("demo/beta", blurred);
  await title("▼1 Nodes – Starmesh");
  const lost = { id: "device-lost/camera/camera", priority: "high", cause: "It does not answer." };
  await tell("demo/beta", lost, blurred);
  await title("◆1 Nodes – Starmesh");
  await tell("demo/beta", stuck, lost, blurred);
  await title("▲1 Nodes – Starmesh");
  await tell("demo/beta", { ...stuck, acknowledged_by: "web/ana", acknowledged_utc: "2026-11-27T02:24:00Z" }, lost, blurred);
  await title("◆1 Nodes – Starmesh");
  await tell("demo/beta");
  await title("Nodes – Starmesh");
  const pictures = await Promise.all([...icons].map((href) => fetch(bus.url + href).then(async (answer) => [answer.status, answer.headers.get("content-type"), await answer.text()])));
  assert.deepEqual(pictures.map(([status, type]) => `${status} ${type}`), Array(4).fill("200 image/svg+xml"));
  assert.equal(new Set(pictures.map(([, , picture]) => picture)).size, 4, "each is another picture");
});

test("an alert that comes again says how often it was raised tonight, and who had acknowledged it", TEST, async () => {
  const before = (minute, change) => ({ ...blurred, raised_utc: `2026-11-27T01:${minute}:00.000000Z`, cleared_utc: `2026-11-27T01:${minute + 2}:00.000000Z`, acknowledged_by: null, ...change });
  let alerts = [before(10), before(40, { acknowledged_by: "web/ana" }), before(50, { id: stuck.id })];
  const ofNight = /\/telescopes\/demo\/beta\/nights\/\d+\/alerts$/;
  await page.route(ofNight, (route) => route.fulfill({ json: { rows: alerts.map((alert) => ({ alert })), truncated: false } }));
  // What another page has read of this night is not asked again at once.
  const again = async (address) => { await page.goto(bus.url + address); await settled(page); };
  const told = ({ id }) => page.locator(`[data-alert="${id}"] [data-testid="came-back"]`);
  await tell("demo/beta", blurred);
  await again("/alerts");
  await told(blurred).filter({ hasText: "It comes and goes: raised 3 times tonight. Before this from 01:40:00 to 01:42:00, acknowledged by web/ana." }).waitFor();
  alerts = alerts.slice(1, 2);
  await again("/t/demo/beta");
  await told(blurred).filter({ hasText: "It came back: raised 2 times tonight. Before this from 01:40:00 to 01:42:00, acknowledged by web/ana." }).waitFor();
  // One is raised for the first time: the archive knows that time alone.
  alerts = [raised(blurred), before(50, { id: stuck.id })];
  await tell("demo/beta", stuck, blurred);
  await again("/alerts");
  await told(stuck).filter({ hasText: "It came back: raised 2 times tonight. Before this from 01:50:00 to 01:52:00." }).waitFor();
  assert.equal(await told(blurred).count(), 0);
  await page.unroute(ofNight);
  await tell("demo/beta");
});

test("what one person acknowledges or shelves the page of another tells, with the name, the time and the reason", TEST, async () => {
  await other.goto(`${bus.url}/alerts`);
  await settled(other);
  await open("/alerts");
  await tell("demo/beta", stuck, blurred);
  const card = (on, id) => on.locator(`[data-alert="${id}"]`);
  await card(page, stuck.id).getByRole("button", { name: "Acknowledge" }).click();
  const [order] = await becomes(bus.orders, (all) => all.length > 0);
  assert.deepEqual([order.key, order.do], ["demo/beta/observatory/order", { acknowledge: stuck.id }]);
  await tell("demo/beta", { ...stuck, acknowledged_by: "web/ana", acknowledged_utc: "2026-11-27T02:29:00Z" }, blurred);
  await card(other, stuck.id).getByText("acknowledged by web/ana at 02:29:00").waitFor();
  await becomes(() => card(other, stuck.id).getByRole("button", { name: "Acknowledge" }).count(), 0);
  await card(page, blurred.id).getByRole("button", { name: "Shelve" }).click();
  const dialog = page.getByRole("dialog");
  await dialog.getByRole("button", { name: "Shelve" }).click();
  await becomes(() => dialog.count(), 1, "without a reason it is not sent");
  await dialog.getByLabel("Why").fill("clouds, it focuses again later");
  await dialog.getByRole("button", { name: "Shelve" }).click();
  const shelve = (await becomes(bus.orders, (all) => all.some((one) => one.do.shelve))).find((one) => one.do.shelve);
  assert.deepEqual([shelve.do.shelve, shelve.reason], [{ alert: blurred.id, for_s: 3600 }, "clouds, it focuses again later"]);
  assert.equal((await bus.orders()).length, 2, "one order each");
  await tell("demo/beta", { ...blurred, shelved_by: "web/ana", shelved_until_utc: "2026-11-27T03:29:00Z", shelved_reason: "clouds" });
  await other.getByRole("region", { name: "Returned, acknowledged and shelved" }).locator(`[data-alert="${blurred.id}"]`).getByText("shelved until 03:29:00: clouds").waitFor();
  // The observatory node takes it back when its time is over.
  await tell("demo/beta", blurred);
  await other.getByRole("region", { name: "Active alerts" }).locator(`[data-alert="${blurred.id}"]`).waitFor();
  // Its cause goes away, and nobody has seen it.
  await tell("demo/beta", { ...stuck, returned_utc: "2026-11-27T02:31:00Z" });
  const returned = other.getByRole("region", { name: "Returned, acknowledged and shelved" }).locator(`[data-alert="${stuck.id}"]`);
  await returned.getByText(/its cause went away at 02:31:00, and nobody has acknowledged it/).waitFor();
  await returned.getByRole("button", { name: "Acknowledge" }).waitFor();
});

test("who may not answer an alert is not offered to", TEST, async () => {
  await tell("demo/beta", blurred);
  await tell("ridge/delta", stuck);
  await open("/alerts");
  const offered = (...rights) => page.evaluate(async (given) => {
    const { me } = await import("/assets/user.js");
    me.value = { ...me.value, rights: given };
    await new Promise((resolve) => { requestAnimationFrame(() => setTimeout(resolve)); });
    return [...document.querySelectorAll('[data-testid="alert"]')].filter((one) => /Acknowledge.*Shelve/.test(one.textContent)).map((one) => one.querySelector(".w a").textContent);
  }, rights);
  await becomes(() => offered("engineer"), ["ridge/delta", "demo/beta"]);
  await becomes(() => offered("operator:ridge/*", "observer"), ["ridge/delta"]);
  await becomes(() => offered("operator:demo/beta"), ["demo/beta"]);
  await becomes(() => offered("observer", "viewer:demo/beta"), []);
  await becomes(() => offered("engineer"), ["ridge/delta", "demo/beta"]);
});

test("forty alerts of one kind are one line that opens, and each critical one stands alone", TEST, async () => {
  await open("/alerts");
  const flood = Array.from({ length: 40 }, (_, n) => ({ id: `device-lost/switch/s${n}`, priority: "high", cause: `switch s${n} does not answer.` }));
  const critical = Array.from({ length: 5 }, (_, n) => ({ id: `dome-not-closed/d${n}`, priority: "critical", cause: `d${n} is half open.` }));
  await tell("demo/beta", ...critical, ...flood);
  await tell("ridge/delta");
  const group = page.locator('[data-testid="alert-kind"]');
  await group.getByText("40 alerts: Device lost").waitFor();
  const shown = () => page.locator('[data-testid="alert"]:visible').count();
  await becomes(shown, 5, "the critical ones alone");
  await group.locator("summary").click();
  await becomes(shown, 45);
  await tell("demo/beta");
  await page.getByText("Nothing is wrong that a person must see to").waitFor();
  assert.deepEqual(problems.filter((one) => !/Failed to load resource/.test(one)), []);
});
