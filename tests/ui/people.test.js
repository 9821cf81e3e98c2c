// Settings, users and the audit: who is signed in, sessions, tokens, and who moved what.
import { test, before, after } from "node:test";
import assert from "node:assert/strict";
import { PASSWORD, TEST, becomes, launch, newPage, problemsOf, settled, startRecorded, startWithUser } from "./browser.js";

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
