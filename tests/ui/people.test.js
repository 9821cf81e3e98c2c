// Settings, users and the audit: who is signed in, sessions, tokens, and who moved what.
import { test, before, after } from "node:test";
import assert from "node:assert/strict";
import { appendFileSync } from "node:fs";
import http from "node:http";
import { PASSWORD, TEST, becomes, launch, newPage, problemsOf, settled, startAlone, startRecorded, startWithUser } from "./browser.js";

let site, url, browser;

before(async () => {
  site = await startWithUser("observer");
  ({ url } = site);
  browser = await launch();
}, TEST);

after(async () => {
  await browser?.close();
  await site?.end();
}, TEST);

const bearer = async (token) => (await fetch(`${url}/api/v1/me`, { headers: { Authorization: `Bearer ${token}` } })).status;

test("a person sees what they may do, makes a token for a program, removes it, and ends the session", TEST, async () => {
  const page = await newPage(browser);
  await page.goto(`${url}/`);
  await page.locator("#name").fill("ana");
  await page.locator("#password").fill(PASSWORD);
  await page.locator("#password").press("Enter");
  await page.locator('body[data-link="live"]').waitFor();
  await page.goto(`${url}/settings`);
  await page.locator('[data-testid="you"]', { hasText: /ana.*observer.*of all telescopes/s }).waitFor();
  await page.locator('[data-testid="sessions"] tbody tr', { hasText: /ana.*this browser/s }).waitFor();

  await page.getByRole("button", { name: "Make a token …" }).click();
  await page.getByLabel("What it is for").fill("cron");
  await page.getByRole("button", { name: "Make", exact: true }).click();
  const token = await page.locator('[data-testid="token"]').textContent();
  assert.equal(await bearer(token), 200, "the token opens the API");
  await page.getByRole("button", { name: "Done" }).click();
  const row = page.locator('[data-testid="tokens"] tbody tr', { hasText: "cron" });
  await becomes(() => row.textContent(), (text) => /ana.*viewer/s.test(text), "it may no more than was chosen");
  await becomes(async () => (await page.content()).includes(token), false, "its secret is shown once");
  await row.getByRole("button", { name: "Remove …" }).click();
  await page.getByRole("dialog").getByRole("button", { name: "Remove" }).click();
  await row.waitFor({ state: "detached" });
  assert.equal(await bearer(token), 401);

  await page.getByRole("button", { name: /End the session of ana/ }).click();
  await page.locator("#login").waitFor();
  await page.close();
});

test("a test message goes to everybody who gets alerts, and what came of each is told", TEST, async () => {
  const got = [];
  const server = http.createServer((request, response) => {
    let body = "";
    request.on("data", (data) => { body += data; });
    request.on("end", () => { got.push(JSON.parse(body)); response.writeHead(request.url === "/night" ? 200 : 403).end(); });
  });
  await new Promise((resolve) => { server.listen(0, "127.0.0.1", resolve); });
  const at = `http://127.0.0.1:${/** @type {any} */ (server.address()).port}`;
  const hook = (name, path) => `[[alerts.webhook]]\nname = "${name}"\nurl = "${at}/${path}"\n`;
  const site = await startAlone((file) => appendFileSync(file, hook("desk", "night") + hook("old-desk", "moved")));
  try {
    const page = await newPage(browser, { viewport: { width: 390, height: 844 } });
    await page.goto(`${site.url}/settings`);
    await settled(page);
    await page.getByRole("button", { name: "Send a test message" }).click();
    const told = page.locator('[data-testid="messages"]');
    await told.getByText("desk webhook taken by its server: look whether it arrives", { exact: true }).waitFor();
    await told.getByText(/^old-desk webhook not sent: it answered 403/).waitFor();
    assert.equal(got.length, 2);
    assert.match(got[0].text, /Nothing is wrong\./);
    await page.getByRole("button", { name: "Send a test message" }).click();
    await told.getByRole("alert").getByText(/sent a moment ago\. Try again in \d+ s/).waitFor();
    assert.equal(got.length, 2);
    await page.close();
  } finally {
    await site.end();
    server.closeAllConnections();
    server.close();
  }
});

test("the audit has a line for each command with what became of it, and is searched", TEST, async () => {
  const bus = await startRecorded();
  try {
    const page = await newPage(browser);
    const problems = problemsOf(page);
    await page.goto(`${bus.url}/t/demo/alpha/audit`);
    await settled(page);
    const rows = page.locator('[data-testid="audit-row"]');
    await rows.first().waitFor();
    const all = await rows.count();
    const verb = await rows.first().locator("td:nth-child(3) b").textContent();
    await page.getByLabel("Search the audit").fill("nothing is called so");
    await rows.first().waitFor({ state: "detached" });
    await page.getByLabel("Search the audit").fill(verb.replaceAll(" ", "_"));
    await rows.first().waitFor();
    assert.ok((await rows.count()) <= all);
    const saved = page.waitForEvent("download");
    await page.getByRole("button", { name: "Save records" }).click();
    assert.equal((await saved).suggestedFilename(), "audit-demo-alpha.jsonl");
    await page.goto(`${bus.url}/audit`);
    await settled(page);
    await page.getByLabel("Telescope").waitFor();
    assert.deepEqual(problems, []);
  } finally {
    await bus.end();
  }
});
