// Settings, users and the audit: who is signed in, sessions, tokens, and who moved what.
import { test } from "node:test";
import assert from "node:assert/strict";
import { appendFileSync } from "node:fs";
import http from "node:http";
import { PASSWORD, TEST, becomes, looks, newPage, problemsOf, settled, startAlone, startRecorded, startWithUser, withBrowser } from "./browser.js";

const [site, browser] = await withBrowser(startWithUser("observer"));
const { url } = site;

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

/** Logs in on the login page, and opens the settings. */
async function logIn(page, name, password) {
  await page.locator("#name").fill(name);
  await page.locator("#password").fill(password);
  await page.locator("#login button").click();
  await page.locator("#login").waitFor({ state: "detached" });
  await settled(page);
}

/** Types a new password twice, in the dialog that is open. */
async function typePassword(page, label, password) {
  await page.getByRole("dialog").getByLabel(label, { exact: true }).fill(password);
  await page.getByLabel("The same again").fill(password);
}

test("the first user is an engineer, adds another who signs in, and changes and removes this one", TEST, async () => {
  const OTHER = "quite another five words";
  const site = await startAlone();
  try {
    const page = await newPage(browser, { viewport: { width: 390, height: 844 } });
    const hold = async () => {
      const button = page.locator("dialog .hold");
      await button.dispatchEvent("pointerdown");
      await becomes(() => button.count(), 0, "what was held is done");
    };
    const users = page.locator('[data-testid="users"]');
    const row = (name) => users.locator(`[data-user="${name}"]`);
    await page.goto(`${site.url}/settings`);
    await settled(page);
    await users.getByText("Nobody is asked here").waitFor();
    await page.getByRole("button", { name: "Add the first user …" }).click();
    await page.getByLabel("Name", { exact: true }).fill("ana");
    await typePassword(page, "Password", PASSWORD);
    await hold();
    await page.locator("#login").waitFor();
    await logIn(page, "ana", PASSWORD);
    await row("ana").getByText("engineer", { exact: true }).waitFor();

    await page.getByRole("button", { name: "Add a user …" }).click();
    await page.getByLabel("Name", { exact: true }).fill("bob");
    await page.getByRole("button", { name: "One more right" }).click();
    await page.getByLabel("Right", { exact: true }).last().selectOption("operator");
    await page.getByLabel("At", { exact: true }).last().selectOption("paranal/io");
    await typePassword(page, "Password", PASSWORD);
    const found = await looks(page, "add a user");
    await page.getByLabel("The same again").fill(OTHER);
    await page.locator("dialog .hold").dispatchEvent("pointerdown");
    await page.getByRole("alert").getByText("The two passwords differ").waitFor();
    assert.equal(await row("bob").count(), 0, "a slip adds nobody");
    await page.getByLabel("The same again").fill(PASSWORD);
    await hold();
    await row("bob").getByText("viewer, operator:paranal/io").waitFor();
    found.push(...(await looks(page, "users")));
    assert.deepEqual(found, []);
    await page.setViewportSize({ width: 390, height: 844 });

    // Bob sees himself alone, and chooses a password that nobody else knows.
    const bobs = await newPage(browser);
    await bobs.goto(`${site.url}/settings`);
    await logIn(bobs, "bob", PASSWORD);
    await bobs.locator('[data-testid="you"]', { hasText: /bob.*operator.*paranal\/io/s }).waitFor();
    assert.equal(await bobs.locator('[data-testid="users"]').count(), 0);
    await bobs.getByRole("button", { name: "Password …" }).click();
    await bobs.getByLabel("The old one").fill("not the password");
    await typePassword(bobs, "The new one", OTHER);
    await bobs.getByRole("button", { name: "Change", exact: true }).click();
    await bobs.getByRole("alert").getByText("it is not your password").waitFor();
    await bobs.getByLabel("The old one").fill(PASSWORD);
    await bobs.getByRole("button", { name: "Change", exact: true }).click();
    await bobs.locator("#login").waitFor();
    await logIn(bobs, "bob", OTHER);

    // Fewer rights are confirmed, more are held; another password and the removal end what bob has open.
    await page.getByRole("button", { name: "Rights of bob" }).click();
    await page.getByRole("button", { name: "Without operator:paranal/io" }).click();
    await page.getByRole("dialog").getByRole("button", { name: "Change", exact: true }).click();
    await becomes(() => row("bob").textContent(), (text) => !/operator/.test(text), "he may less");
    await page.getByRole("button", { name: "Rights of bob" }).click();
    await page.getByLabel("Right", { exact: true }).selectOption("observer");
    await hold();
    await row("bob").getByText("observer", { exact: true }).waitFor();
    await page.getByRole("button", { name: "Password of bob" }).click();
    await typePassword(page, "Password", PASSWORD);
    await hold();
    await bobs.locator("#login").waitFor();
    await logIn(bobs, "bob", PASSWORD);
    await page.getByRole("button", { name: "Remove bob" }).click();
    await page.getByRole("dialog").getByRole("button", { name: "Remove" }).click();
    await row("bob").waitFor({ state: "detached" });
    await bobs.locator("#login").waitFor();
    await page.getByRole("button", { name: "Remove ana" }).click();
    await page.getByRole("dialog").getByRole("button", { name: "Remove" }).click();
    await page.locator(".toast", { hasText: "make another engineer first" }).waitFor();
    await row("ana").waitFor();
    await bobs.close();
    await page.close();
  } finally {
    await site.end();
  }
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
