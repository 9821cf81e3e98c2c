// The login page: shown instead of the page where there are users, and left by logging in.
import { test, before, after } from "node:test";
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { binary, comesUp, end, freePort, launch } from "./browser.js";

const PASSWORD = "four plain words here";
let node, browser, port, folder, file;

before(async () => {
  port = await freePort();
  folder = mkdtempSync(join(tmpdir(), "starmesh-login-"));
  file = join(folder, "observatory.toml");
  writeFileSync(file, `[observatory]\nsite = "paranal"\ntelescope = "io"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n` +
    `elevation_m = 2500\n[bus]\nmulticast = false\n[web]\nlisten = "127.0.0.1:${port}"\n`);
  execFileSync(binary, ["user", "add", "ana", "--right", "viewer", "--password-file", "-", "--config", file], { input: `${PASSWORD}\n` });
  node = spawn(binary, ["node", "web", "--config", file], { stdio: "ignore" });
  await comesUp(node, port);
  browser = await launch();
}, { timeout: 120_000 });

after(async () => {
  await browser?.close();
  await end(node, "SIGTERM");
  rmSync(folder, { recursive: true, force: true });
}, { timeout: 60_000 });

test("a person logs in, sees the page, and logs out", { timeout: 120_000 }, async () => {
  const page = await browser.newPage();
  const broken = [];
  page.on("console", (message) => message.type() === "error" && /Content Security Policy/.test(message.text()) && broken.push(message.text()));
  await page.goto(`http://127.0.0.1:${port}/t/paranal/io`);
  await page.locator("#name").fill("ana");
  await page.locator("#password").fill("not the password");
  await page.locator("#login button").click();
  await page.locator("#answer", { hasText: "The name or the password is wrong." }).waitFor({ timeout: 20_000 });
  assert.equal(await page.locator("#user").count(), 0, "nothing of the page is there yet");
  await page.locator("#password").fill(PASSWORD);
  await page.locator("#password").press("Enter");
  await page.locator("#user", { hasText: "ana" }).waitFor({ timeout: 20_000 });
  await page.locator('body[data-link="live"]').waitFor({ timeout: 20_000 });
  assert.equal(new URL(page.url()).pathname, "/t/paranal/io", "the page that was asked for");
  assert.equal(await page.evaluate(() => document.cookie), "", "no script sees the session");
  await page.locator("#user button").click();
  await page.locator("#login").waitFor({ timeout: 20_000 });
  // longer than a page may be without drawing itself: the login page is not called broken
  await page.waitForTimeout(7000);
  assert.equal(await page.locator("#login button").isVisible(), true);
  assert.deepEqual(broken, []);
  await page.close();
});

test("a page whose user is removed becomes the login page", { timeout: 120_000 }, async () => {
  const page = await browser.newPage();
  await page.goto(`http://127.0.0.1:${port}/`);
  await page.locator("#name").fill("ana");
  await page.locator("#password").fill(PASSWORD);
  await page.locator("#login button").click();
  await page.locator('body[data-link="live"]').waitFor({ timeout: 20_000 });
  execFileSync(binary, ["user", "remove", "ana", "--config", file]);
  await page.locator("#login").waitFor({ timeout: 30_000 });
  await page.close();
});
