// What every test of the page needs: the program under test, a port for its page, and Debian's Chromium.
import assert from "node:assert/strict";
import { createServer } from "node:net";
import { join } from "node:path";
import { chromium } from "playwright-core";

export const binary = process.env.STARMESH_BIN ?? join(import.meta.dirname, "../../target/debug/starmesh");

// below the range from which the kernel gives ports to whoever connects: a server that is started again finds its own
export const freePort = () =>
  new Promise((resolve) => {
    const port = 20_000 + Math.floor(Math.random() * 12_000);
    const server = createServer()
      .listen(port, "127.0.0.1", () => server.close(() => resolve(port)))
      .once("error", () => resolve(freePort()));
  });

export const launch = () =>
  chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
      "--disable-component-update", "--disable-sync"],
  });

/** Waits until the page of a process answers on this port; `why` completes the message if it does not. */
export async function comesUp(process, port, why = () => "", limit = 60_000) {
  const until = Date.now() + limit;
  while (!(await fetch(`http://127.0.0.1:${port}/healthz`).then((r) => r.ok, () => false))) {
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
