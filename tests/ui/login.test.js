// The login page: shown instead of the page where there are users, and left by logging in.
import { test } from "node:test";
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { PASSWORD, TEST, becomes, binary, newPage, problemsOf, startWithUser, withBrowser } from "./browser.js";

const [site, browser] = await withBrowser(startWithUser("viewer"));
const { url } = site;

test("a person logs in, sees the page, and logs out", TEST, async () => {
  const page = await newPage(browser);
  const problems = problemsOf(page);
  await page.goto(`${url}/t/paranal/io`);
  await page.locator("#name").fill("ana");
  await page.locator("#password").fill("not the password");
  await page.locator("#login button").click();
  await page.locator("#answer", { hasText: "The name or the password is wrong." }).waitFor();
  assert.equal(await page.locator(".rail").count(), 0, "nothing of the page is there yet");
  await page.locator("#password").fill(PASSWORD);
  await page.locator("#password").press("Enter");
  await page.locator(".rail .me", { hasText: "ana" }).waitFor();
  await page.locator('body[data-link="live"]').waitFor();
  assert.equal(new URL(page.url()).pathname, "/t/paranal/io", "the page that was asked for");
  assert.equal(await page.evaluate(() => document.cookie), "", "no script sees the session");
  await page.locator(".rail .me button").click();
  await page.locator("#login").waitFor();
  await becomes(() => page.evaluate(() => caches.has("picture")), false, "nothing of the telescopes is left in the browser");
  // Longer than a page may be without drawing itself: the login page is not called broken.
  await page.clock.install();
  await page.reload();
  await page.clock.runFor(7000);
  assert.equal(await page.locator("#login button").isVisible(), true);
  assert.deepEqual(problems.filter((one) => !/Failed to load resource/.test(one)), []);
  await page.close();
});

test("a page whose user is removed becomes the login page", TEST, async () => {
  const page = await newPage(browser);
  await page.goto(`${url}/`);
  await page.locator("#name").fill("ana");
  await page.locator("#password").fill(PASSWORD);
  await page.locator("#login button").click();
  await page.locator('body[data-link="live"]').waitFor();
  execFileSync(binary, ["user", "remove", "ana", "--config", site.file]);
  await page.locator("#login").waitFor();
  await page.close();
});
