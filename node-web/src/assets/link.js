// The live socket and what it has told: a mirror of what the web node hears.

/** Everything the page knows. Times are this browser's monotonic milliseconds. */
export const store = {
  /** `connecting` before the first word, then `live` or `lost`. */
  link: "connecting",
  lostAt: null,
  version: "",
  /** Sky time of the server, when it was told, and how fast it runs. */
  sky: null,
  net: new Map(),
  watch: null,
  /** True once the watched telescope's snapshot is here. */
  whole: false,
  /** Why the last message could not be read, while the page waits for a whole new one. */
  fault: "",
  states: new Map(),
  log: [],
};

const SILENT_MS = 3000;
const KEPT_LINES = 600;
let socket = null;
let heard = 0;
let tries = 0;
let retry = 0;
let changed = () => {};

/** Opens the socket and keeps it open; `onChange` is called when something differs. */
export function start(onChange) {
  changed = onChange;
  connect();
  setInterval(() => {
    if (store.link === "live" && performance.now() - heard > SILENT_MS) lose();
    changed();
  }, 1000);
  addEventListener("online", () => socket === null && connect());
}

/** Something that the page shows is ready. */
export const touch = () => changed();

/** Chooses what is shown: `site/telescope`, or null for the overview. */
export function watch(telescope) {
  if (telescope === store.watch) return;
  store.watch = telescope;
  forget();
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ op: "watch", telescope }));
}

/** Sky time now, ms since 1970, ticking with the server's clock. */
export function skyNow() {
  return store.sky && store.sky.utc + (performance.now() - store.sky.at) * store.sky.speed;
}

/** Age of something heard, s. */
export const ageOf = (entry) => (performance.now() - entry.since) / 1000;

/** What an age is worth; nothing is fresh while the link is lost. The server judges by the same rule. */
export function quality(age, period) {
  const judged = period === null ? "fresh" : age > Math.max(5 * period, 15) ? "lost" : age > Math.max(2 * period, 5) ? "stale" : "fresh";
  return store.link === "live" || judged === "lost" ? judged : "stale";
}

function connect() {
  clearTimeout(retry);
  const query = store.watch ? `?telescope=${encodeURIComponent(store.watch)}` : "";
  const asked = store.watch;
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/v1/ws${query}`);
  socket = opened;
  heard = performance.now();
  opened.onopen = () => {
    if (asked !== store.watch) opened.send(JSON.stringify({ op: "watch", telescope: store.watch }));
  };
  opened.onmessage = (event) => {
    if (opened !== socket) return;
    const now = performance.now();
    try {
      take(JSON.parse(event.data), now);
    } catch (error) {
      // what was taken in may be half of it: begin anew with a whole picture, and let nothing old look live
      console.warn("a message cannot be read", error);
      store.fault = "What the server sent cannot be read.";
      lose();
      return;
    }
    heard = now;
    tries = 0;
    if (store.link !== "live") store.lostAt = null;
    store.link = "live";
    store.fault = "";
    changed();
  };
  opened.onclose = () => {
    if (opened === socket) lose();
  };
}

function lose() {
  const old = socket;
  socket = null;
  old?.close();
  if (store.link === "live") store.lostAt = skyNow();
  store.link = store.link === "connecting" && tries < 2 ? "connecting" : "lost";
  const wait = Math.min(8000, 500 * 2 ** tries) * (0.7 + 0.6 * Math.random());
  tries += 1;
  clearTimeout(retry);
  retry = setTimeout(connect, wait);
  changed();
}

function forget() {
  store.whole = false;
  store.states.clear();
  store.log = [];
}

function take(said, now) {
  store.sky = { utc: Date.parse(said.server_time_utc), at: now, speed: said.speed };
  if (said.op === "snap") {
    store.version = said.version;
    store.net.clear();
    if (said.watch === store.watch) {
      forget();
      store.whole = true;
    }
  }
  for (const summary of said.net ?? []) store.net.set(summary.id, { ...summary, received: now });
  for (const [id, ages] of Object.entries(said.ages ?? {})) {
    const summary = store.net.get(id);
    if (summary) store.net.set(id, { ...summary, ...ages, received: now });
  }
  // words of a telescope that is no longer shown may still be on their way
  if (!store.whole) return;
  for (const [key, entry] of Object.entries(said.states ?? {})) store.states.set(key, { ...entry, since: now - entry.age_s * 1000 });
  for (const [key, [age, utc]] of Object.entries(said.again ?? {})) {
    const entry = store.states.get(key);
    if (entry) Object.assign(entry, { since: now - age * 1000, at_utc: utc });
  }
  if (said.log?.length) {
    store.log = [...said.log, ...store.log].sort((a, b) => (a.at_utc < b.at_utc ? 1 : a.at_utc > b.at_utc ? -1 : b.number - a.number));
    store.log.length = Math.min(store.log.length, KEPT_LINES);
  }
}
