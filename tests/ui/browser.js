// What every test of the page needs: the program under test, a web node with its page, and Debian's Chromium.
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { chromium } from "playwright-core";

export const binary = process.env.STARMESH_BIN ?? join(import.meta.dirname, "../../target/debug/starmesh");

/** Nothing takes so long, ms, unless it hangs. */
export const LIMIT = 120_000;
/** For a test, which waits several times. */
export const TEST = { timeout: 10 * LIMIT };

export const launch = () =>
  chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
      "--disable-component-update", "--disable-sync"],
  });

/** A page whose waits end when something hangs, and not before. */
export async function newPage(browser, options = {}) {
  const page = await browser.newPage(options);
  page.setDefaultTimeout(LIMIT);
  return page;
}

/** Writes the configuration of a telescope that has a web node alone, whose page gets a port from the kernel; returns the file. */
export function configure(folder) {
  const file = join(folder, "observatory.toml");
  writeFileSync(file, `[observatory]\nsite = "paranal"\ntelescope = "io"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n` +
    `elevation_m = 2500\n[bus]\nmulticast = false\n[web]\nlisten = "127.0.0.1:0"\n`);
  return file;
}

/** Starts the web node; gives its process, and the address that it prints for its page once that answers. */
export async function startWebNode(file) {
  const node = spawn(binary, ["node", "web", "--config", file], { stdio: ["ignore", "ignore", "pipe"] });
  let printed = "";
  node.stderr.on("data", (data) => (printed += data));
  const url = () => /page: (http:\/\/[\d.:]+)\//.exec(printed)?.[1];
  await comesUp(node, url, () => `:\n${printed}`);
  return { node, url: url() };
}

/** Waits until the page of a process answers; `url` gives its address once it is known, and `why` completes the message if it does not. */
export async function comesUp(process, url, why = () => "") {
  const until = Date.now() + LIMIT;
  while (!url() || !(await fetch(`${url()}/healthz`).then((r) => r.ok, () => false))) {
    assert.ok(Date.now() < until && process.exitCode === null, `the page did not come up${why()}`);
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
}

/** Ends a process in the orderly way. */
export async function end(process, signal) {
  if (!process || process.exitCode !== null) return;
  process.kill(signal);
  await new Promise((resolve) => process.once("exit", resolve));
}
