// What every test of the page needs: the program under test, a web node with its page, a recorded bus, and Debian's Chromium.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import http from "node:http";
import net from "node:net";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after } from "node:test";
import { isDeepStrictEqual, inspect } from "node:util";
import { chromium } from "playwright-core";

const root = join(import.meta.dirname, "../..");
export const binary = process.env.STARMESH_BIN ?? join(root, "target/debug/starmesh");
const python = process.env.STARMESH_PYTHON ?? join(root, "target/venv/bin/python");

/** Nothing takes so long, ms, unless it hangs. */
export const LIMIT = 120_000;
/** For a test, which waits several times. */
export const TEST = { timeout: 10 * LIMIT };

// What a file of tests started ends with it, also where the file fails before its first test.
const children = [];
process.once("exit", () => children.forEach((child) => child.kill()));
function start(program, args, options) {
  const child = spawn(program, args, options);
  children.push(child);
  return child;
}

/**
 * Chromium: without windows where Debian's package of that is there, which lays out the same and takes a fifth less of the processors. A test of what only the whole browser can, such as push
 * messages, asks for `whole`.
 */
export const launch = (more = [], { whole = false } = {}) =>
  chromium.launch({
    executablePath: process.env.CHROMIUM ?? execFileSync("sh", ["-c", `${whole ? "" : "command -v chromium-headless-shell || "}command -v chromium`], { encoding: "utf8" }).trim(),
    args: ["--no-sandbox", "--disable-gpu", ...(whole ? [] : ["--in-process-gpu", "--font-render-hinting=none"]), "--disable-quic", "--no-first-run", "--disable-background-networking",
      "--disable-component-update", "--disable-sync", ...more],
  });

/** A page whose waits end when something hangs, and not before, and in which nothing moves; `UI_SLOWER` says how many times slower it runs, which shows what a test takes for done too early. What a service worker asks for no test could replace, so there is none unless it is asked for. */
export async function newPage(browser, options = {}) {
  const page = await browser.newPage({ serviceWorkers: "block", reducedMotion: "reduce", ...options });
  page.setDefaultTimeout(LIMIT);
  if (process.env.UI_SLOWER) await (await page.context().newCDPSession(page)).send("Emulation.setCPUThrottlingRate", { rate: Number(process.env.UI_SLOWER) });
  return page;
}

/**
 * Makes a page of one server as good as new for the next test: nothing is shown and kept, no request is routed, `problems` is empty. The test loads an address then, which costs
 * less than in another page, whose context has no files yet. Routes of sockets, scripts that were added, and what the context has (touch, a clock, a time zone) stay: a test that
 * alone needs one of them has a page of its own.
 */
export async function fresh(page, { viewport = null, problems = [] } = {}) {
  if (page.url() !== "about:blank") {
    // A document of the same server without scripts: the page itself, as long as it is there, may keep something again.
    await page.goto(new URL("/healthz", page.url()).href);
    await page.evaluate(async () => {
      localStorage.clear();
      sessionStorage.clear();
      for (const name of await caches.keys()) await caches.delete(name);
    });
  }
  // The handlers of requests that the page has left may still run.
  await page.unrouteAll({ behavior: "ignoreErrors" });
  await page.context().clearCookies();
  if (viewport) await page.setViewportSize(viewport);
  problems.length = 0;
}

/** Waits until `read()` gives what is wanted, a value or what a function says yes to, and gives that. A page draws when it comes to it, so no test asks it just once. */
export async function becomes(read, wanted, told = "") {
  const met = typeof wanted === "function" ? wanted : (found) => isDeepStrictEqual(found, wanted);
  for (const end = Date.now() + LIMIT; ;) {
    const found = await read();
    if (met(found)) return found;
    assert.ok(Date.now() < end, `${told || "it never becomes so"}: ${inspect(found)}${typeof wanted === "function" ? "" : ` is not ${inspect(wanted)}`}`);
    await new Promise((resolve) => { setTimeout(resolve, 50); });
  }
}

/** Where an element is once it has a place; what is drawn anew has none for a moment, and maybe another one then. */
export const boxOf = (element) => becomes(() => element.boundingBox(), Boolean, "it has a place on the page");

/** What an element says, with single blanks. */
export const text = (locator) => locator.evaluate((one) => one.innerText.replace(/\s+/g, " "));

/** Are two numbers no further apart than that? */
export const near = (a, b, most) => Math.abs(a - b) <= most;

/** The address that a page shows. */
export const addressOf = (page) => { const { pathname, searchParams } = new URL(page.url()); return { pathname, ...Object.fromEntries(searchParams) }; };

/** For writing the page: before a web node, its files as they are on the disk now, without building the program. Gives the address. */
async function fromDisk(node, url, at) {
  const assets = join(root, "node-web/src/assets");
  const { hostname, port } = new URL(url);
  const types = { js: "text/javascript", css: "text/css", svg: "image/svg+xml", html: "text/html", woff2: "font/woff2", webmanifest: "application/manifest+json" };
  const asked = (request) => ({ hostname, port, path: request.url, method: request.method, headers: { ...request.headers, host: `${hostname}:${port}`, ...(request.headers.origin && { origin: url }) } });
  const server = http.createServer((request, response) => {
    const forward = http.request(asked(request), (answer) => {
      const { pathname } = new URL(request.url, url);
      const isLogin = answer.statusCode === 401;
      const file = join(assets, pathname.startsWith("/assets/") ? pathname.slice("/assets/".length) : isLogin ? "login.html" : "index.html");
      if (![200, 401, 404].includes(answer.statusCode) || (isLogin && pathname.startsWith("/assets/")) || /^\/(api|lite|metrics|problems|healthz|readyz|version)/.test(pathname) || !existsSync(file)) {
        response.writeHead(answer.statusCode, answer.headers);
        return void answer.pipe(response);
      }
      answer.resume();
      const { "content-security-policy": policy, "referrer-policy": referrer } = answer.headers;
      response.writeHead(isLogin ? 401 : 200, { "content-type": types[file.split(".").pop()] ?? "text/plain", "content-security-policy": policy, "referrer-policy": referrer, "cache-control": "no-cache", "service-worker-allowed": "/" });
      response.end(readFileSync(file));
    });
    forward.on("error", () => request.socket.destroy());
    request.pipe(forward);
  });
  server.on("upgrade", (request, socket, head) => {
    const { headers } = asked(request);
    const to = net.connect(Number(port), hostname, () => {
      to.write(`GET ${request.url} HTTP/1.1\r\n${Object.entries(headers).map(([name, value]) => `${name}: ${value}`).join("\r\n")}\r\n\r\n`);
      to.write(head);
      to.pipe(socket).pipe(to);
    });
    for (const [one, other] of [[to, socket], [socket, to]]) one.on("error", () => other.destroy()).on("close", () => other.destroy());
  });
  await new Promise((resolve) => { server.listen(at, "127.0.0.1", resolve); });
  node.once("exit", () => { server.close(); server.closeAllConnections(); });
  return `http://127.0.0.1:${/** @type {any} */ (server.address()).port}`;
}

/** What a page must never do: errors of the console, of scripts and of the security policy, and requests to other origins. */
export function problemsOf(page) {
  const problems = [];
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && !/blocked by Playwright/.test(message.text()) && problems.push(`${page.url()}: ${message.text()}${message.location().url ? ` (${message.location().url})` : ""}`));
  page.on("pageerror", (error) => problems.push(`${page.url()}: ${error.stack ?? error}`));
  page.on("request", (request) => {
    const { origin, protocol } = new URL(request.url());
    if (/^(http|ws)s?:$/.test(protocol) && origin.replace("ws:", "http:") !== new URL(page.url()).origin && page.url() !== "about:blank") problems.push(`${page.url()} asks ${request.url()}`);
  });
  page.on("dialog", (dialog) => {
    // Whoever leaves a draft that is not stored is asked first.
    if (dialog.type() === "beforeunload") return void dialog.accept();
    problems.push(`${page.url()}: a dialog of the browser: ${dialog.message()}`);
    dialog.dismiss();
  });
  return problems;
}

/** Writes the configuration of a telescope that has a web node alone, whose page gets a port from the kernel; returns the file. */
export function configure(folder, { telescope = "paranal/io", connect = [], clock = "", port = 0, web = "" } = {}) {
  const [site, name] = telescope.split("/");
  const file = join(folder, "observatory.toml");
  writeFileSync(file, `[observatory]\nsite = "${site}"\ntelescope = "${name}"\nlatitude_deg = -24.6\nlongitude_deg = -70.4\n` +
    `elevation_m = 2500\n[bus]\nmulticast = false\nconnect = ${JSON.stringify(connect)}\n${clock && `[clock]\nsimulator = "${clock}"\n`}` +
    `[web]\nlisten = "127.0.0.1:${port}"\n${web}`);
  return file;
}

/** Starts the web node; gives its process, and the address that it prints for its page once that answers. */
export async function startWebNode(file, at = 0) {
  const node = start(binary, ["node", "web", "--config", file], { stdio: ["ignore", "ignore", "pipe"] });
  let printed = "";
  node.stderr.on("data", (data) => (printed += data));
  const url = () => /page: (http:\/\/[\d.:]+)\//.exec(printed)?.[1];
  await comesUp(node, url, () => `:\n${printed}`);
  return { node, url: process.env.UI_FROM_DISK ? await fromDisk(node, url(), at) : url() };
}

export const PASSWORD = "four plain words here";

/** A web node with nothing around it, once `prepare(file)` has seen its configuration: `{ url, file, end }`. */
export async function startAlone(prepare = (_) => {}) {
  const folder = mkdtempSync(join(tmpdir(), "starmesh-alone-"));
  const file = configure(folder);
  prepare(file);
  const { node, url } = await startWebNode(file);
  return { url, file, end: async () => {
    await end(node, "SIGTERM");
    rmSync(folder, { recursive: true, force: true });
  } };
}

/** A web node that knows one person, `ana` with [`PASSWORD`]: `{ url, file, end }`. */
export const startWithUser = (right) => startAlone((file) =>
  execFileSync(binary, ["user", "add", "ana", "--right", right, "--password-file", "-", "--config", file], { input: `${PASSWORD}\n` }));

/** A site that `starting` gives, and a browser, for all tests of a file: `[site, browser]`; both are ended when the tests are over. */
export async function withBrowser(starting, more = [], options = {}) {
  const site = await starting;
  const browser = await launch(more, options);
  after(async () => {
    await browser.close();
    await site.end();
  }, TEST);
  return [site, browser];
}

/**
 * A web node on a recorded bus: `{ url, put, now, events, raw, orders, reset, end }`. The night of the telescope `demo/alpha` is played again
 * and again, so that everything stays fresh, and the archive's answers are recorded too. `web` is more of `[web]` in its configuration.
 */
export async function startRecorded({ web = "" } = {}) {
  const folder = mkdtempSync(join(tmpdir(), "starmesh-recorded-"));
  const recorded = join(import.meta.dirname, "recorded");
  const player = start(python, ["-B", join(recorded, "player.py"), join(recorded, "bus.jsonl")], { stdio: ["pipe", "pipe", process.env.KEEP_UI ? "inherit" : "ignore"] });
  const line = await new Promise((resolve, reject) => {
    let text = "";
    player.stdout.on("data", (data) => { text += data; if (text.includes("\n")) resolve(text); });
    player.once("exit", (code) => reject(new Error(`the player of the recorded bus ended with ${code}: is ${python} made by scripts/setup test?`)));
    player.once("error", reject);
  });
  const { bus, http } = JSON.parse(line);
  const post = (path) => async (body) => assert.ok((await fetch(`${http}${path}`, { method: "POST", body: JSON.stringify(body ?? null) })).ok, path);
  const options = { telescope: "demo/alpha", connect: [bus], clock: http, web };
  let { node, url } = await startWebNode(configure(folder, options));
  /** Ends the web node, and starts it again at its address. */
  const stop = () => end(node, "SIGTERM");
  const at = Number(new URL(url).port);
  const again = async () => { ({ node } = await startWebNode(configure(folder, { ...options, port: process.env.UI_FROM_DISK ? 0 : at }), at)); };
  const end_ = async () => {
    await stop();
    await end(player, "SIGTERM");
    rmSync(folder, { recursive: true, force: true });
  };
  return { url, stop, again, put: post("/put"), raw: post("/raw"), now: post("/now"), events: post("/events"), reset: post("/reset"), orders: () => fetch(`${http}/orders`).then((r) => r.json()),
    states: () => fetch(`${http}/states`).then((r) => r.json()), end: end_ };
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
  if (!process || process.exitCode !== null || process.signalCode !== null) return;
  process.kill(signal);
  await new Promise((resolve) => process.once("exit", resolve));
}

/** Names of the pages, from the page itself. */
export const namesOf = (page) => page.evaluate(() => import("/assets/pages.js").then(({ pages }) => ({ network: Object.keys(pages.network), telescope: Object.keys(pages.telescope) })));

/** Addresses of every page of a telescope of the recorded bus, as the table of pages has them. */
export async function everyAddress(page, id = "demo/alpha") {
  const names = await namesOf(page);
  const network = names.network.map((name) => (name === "network" ? "/" : `/${name}`));
  const telescope = names.telescope.map((name) => (name === "now" ? `/t/${id}` : `/t/${id}/${name}`));
  return [...network, ...telescope, `/t/${id}/devices/telescope/mount`];
}

/** Waits until a page has read what it shows. */
export const settled = (page) => page.waitForFunction(() => {
  const main = document.querySelector("main");
  return document.body?.dataset.link === "live" && main?.textContent && !/Reading |reading …|Connecting …|Loading …/.test(main.textContent);
});

/** Goes to another page of the server as a link does, without loading anything anew, and waits until it has read what it shows. From another server, from the same path, or from what is not the page, it is loaded. */
export async function follow(page, url) {
  const isFollowed = await page.evaluate(async (to) => {
    const { origin, pathname, search } = new URL(to);
    if (origin !== location.origin || pathname === location.pathname || !document.getElementById("app")) return false;
    const { go } = await import("/assets/route.js");
    go(pathname + search);
    // It is drawn before the first of these frames, and has asked for what it shows after the second.
    await new Promise((resolve) => { requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(resolve))); });
    return true;
  }, url);
  if (!isFollowed) await page.goto(url);
  await settled(page);
}

/** How often each component is drawn by a second that passes, or by a change of the summary of `id`. */
export const drawnBy = (page, id = null, change = {}) => page.evaluate(async ([name, more]) => {
  const { options } = await import("/assets/vendor/preact.js");
  const { net, tick } = await import("/assets/store.js");
  const before = options.__r;
  const counts = {};
  options.__r = (vnode) => { if (typeof vnode.type === "function") counts[vnode.type.name] = (counts[vnode.type.name] ?? 0) + 1; before?.(vnode); };
  if (name) net.value = new Map(net.value).set(name, { ...net.value.get(name), ...more });
  else tick.value += 1;
  await new Promise((resolve) => { setTimeout(resolve); });
  options.__r = before;
  return counts;
}, /** @type {const} */ ([id, change]));

/** The least that one of several counts of [`drawnBy`] has: what comes from the bus in the same moment draws, too. */
export const least = (all, name) => Math.min(...all.map((counts) => counts[name] ?? 0));

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
export const THEMES = ["dark", "light", "night"];

/** Presses the theme's button. */
export const chooseTheme = (page, theme) => page.evaluate((name) => document.querySelector(`[data-set-theme="${name}"]`).click(), theme);

/** How texts look that axe-core has found readable, on any page and in any theme: what looks the same is as readable. */
const readable = new Set();

/**
 * Runs in a page that has axe-core: `found`, its serious findings, one line each. With `known`, of the contrast alone, and only of texts that look like none of these;
 * `passed` is then how those look that are readable.
 */
async function look(known) {
  const { axe } = /** @type {any} */ (window);
  const ask = (context, values, resultTypes) => axe.run(context, { runOnly: { type: "rule", values }, resultTypes, elementRef: true, selectors: false });
  const lines = ({ violations }) => violations.flatMap(({ id, nodes }) => nodes.map(({ element, any }) => `${id}: ${element.outerHTML.slice(0, 160)} ${any[0]?.message ?? ""}`));
  if (!known) {
    // Findings of the other rules would be none of these.
    const isSerious = ({ enabled, impact, tags }) => enabled && ["serious", "critical"].includes(impact) && !tags.some((tag) => ["experimental", "deprecated"].includes(tag));
    return { found: lines(await ask(document, axe._audit.rules.filter(isSerious).map(({ id }) => id), ["violations"])), passed: [] };
  }
  const backgrounds = new Map([[null, ""]]);
  /** What is painted behind the text of an element, by itself and by all around it. */
  const background = (one) => {
    if (!backgrounds.has(one)) {
      const { backgroundColor, backgroundImage, opacity, filter, mixBlendMode } = getComputedStyle(one);
      const own = [backgroundColor, backgroundImage, opacity, filter, mixBlendMode].join(" ");
      backgrounds.set(one, background(one.parentElement) + (own === "rgba(0, 0, 0, 0) none 1 none normal" ? "" : ` / ${own}`));
    }
    return backgrounds.get(one);
  };
  const looksLike = (one) => {
    const { color, fontSize, fontWeight, textShadow } = getComputedStyle(one);
    return `${color} ${fontSize} ${fontWeight} ${textShadow}${background(one)}`;
  };
  // Of what axe-core leaves out nothing is ever found readable: it would be looked at again on each page.
  const isShown = (one) => {
    const { width, height, right, bottom } = one.getBoundingClientRect();
    return width > 1 && height > 1 && right + scrollX > 0 && bottom + scrollY > 0 && one.checkVisibility({ opacityProperty: true, visibilityProperty: true }) && !one.closest(':disabled, [aria-disabled="true"], [aria-hidden="true"], [inert]');
  };
  const says = (text) => axe.commons.text.removeUnicode(text.trim(), { emoji: true, nonBmp: false, punctuations: true }) !== "";
  const isText = (one) => one.matches('input:not([type="checkbox"], [type="radio"], [type="range"], [type="hidden"]), select, textarea') || [...one.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && says(node.data));
  const texts = new Map([...document.body.querySelectorAll("*")].filter((one) => isText(one) && isShown(one)).map((one) => [one, looksLike(one)]));
  const before = new Set(known);
  const unlike = [...texts.keys()].filter((one) => !before.has(texts.get(one)));
  if (!unlike.length) return { found: [], passed: [] };
  const judged = await ask({ include: unlike }, ["color-contrast"], ["violations", "passes"]);
  const passes = judged.passes.flatMap(({ nodes }) => nodes).filter(({ element, any }) => texts.has(element) && any[0]?.data?.fgColor);
  return { found: lines(judged), passed: [...new Set(passes.map(({ element }) => texts.get(element)))] };
}

/** Serious findings of axe-core, one line each; `known` as in [`look`]. */
async function findings(page, known = null) {
  // Whole pieces of the page in its answers would cost more than it does.
  if (!(await page.evaluate(() => "axe" in window))) await page.evaluate(`${axe}\n;axe.configure({ noHtml: true });`);
  const { found, passed } = await page.evaluate(look, known && [...known]);
  for (const one of passed) readable.add(one);
  return found;
}

/** Parts that are wider than a phone although nothing around them scrolls. */
export const tooWide = (page) => page.evaluate(() => {
  const { scrollWidth, clientWidth } = document.documentElement;
  if (scrollWidth <= clientWidth) return null;
  const wide = [...document.querySelectorAll("main *")].filter((one) => one.getBoundingClientRect().right > clientWidth + 1 && !one.closest(".tw, .sites, .tabs, .scroll, .log"));
  return `${scrollWidth} px of ${clientWidth}: ${wide.slice(0, 5).map((one) => `${one.tagName}.${one.getAttribute("class")}`).join(" ")}`;
});

/** In `scripts/proof pages` each page is seen at each width, in each theme and with each sort of bad text and answer; `scripts/test` sees each of these once. */
export const EVERY = Boolean(process.env.UI_EVERY_LOOK);

const [WIDE, PHONE] = [{ width: 1280, height: 900 }, { width: 390, height: 844 }];
/** All rules are asked in the dark theme; a theme is colours, so of the others only whether they can be read. */
export const LOOKS = EVERY ? [WIDE, PHONE].flatMap((size) => THEMES.map((theme) => [size, theme])) : [[WIDE, "light"], [WIDE, "night"], [PHONE, "dark"]];
/** For a part of a page: how it looks on a phone. */
const LAST_LOOK = EVERY ? LOOKS : LOOKS.slice(-1);

/** The page as it is now: what axe-core finds serious, and what is too wide. */
export async function looks(page, where, all = LAST_LOOK) {
  const found = [];
  for (const [size, theme] of all) {
    await page.setViewportSize(size);
    await chooseTheme(page, theme);
    found.push(...(await findings(page, theme === "dark" ? null : readable)).map((one) => `${where} ${size.width} ${theme}: ${one}`));
    const wide = await tooWide(page);
    if (wide) found.push(`${where} ${size.width} ${theme}: sideways scroll, ${wide}`);
  }
  return found;
}
