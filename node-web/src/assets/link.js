// The live socket and what it has sent: a mirror of what the web node receives.

import { askUser } from "./user.js";

/** Everything the page knows. Times are this browser's monotonic milliseconds. */
export const store = {
  /** `connecting` before the first word, then `live` or `lost`. */
  link: "connecting",
  lostAt: null,
  version: "",
  /** Sky time of the server, when it was received, and how fast it runs. */
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
  askUser();
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
  if (socket?.readyState === WebSocket.OPEN) subscribe(socket);
}

const topicsOf = (telescope) => telescope ? [`tel/${telescope}`, `log?telescope=${telescope}`] : [];

/** Asks for all that the page shows, and for no other telescope any more. */
function subscribe(opened) {
  const wanted = topicsOf(store.watch);
  const ended = opened.topics.filter((topic) => !wanted.includes(topic));
  if (ended.length) opened.send(JSON.stringify({ op: "unsub", topics: ended }));
  opened.send(JSON.stringify({ op: "sub", topics: opened.hasNetwork ? wanted : ["net", ...wanted] }));
  Object.assign(opened, { topics: wanted, hasNetwork: true });
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
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/v1/ws`);
  opened.topics = [];
  socket = opened;
  heard = performance.now();
  opened.onopen = () => subscribe(opened);
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
  askUser();
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

function take(message, now) {
  const { op, topic, data } = message;
  store.sky = { utc: Date.parse(message.at_utc), at: now, speed: data.speed ?? store.sky?.speed ?? 1 };
  if (op === "welcome") store.version = data.version;
  else if (op === "err") console.warn(data.detail);
  else if (topic === "net") takeNetwork(op, data, now);
  // words of a telescope that is no longer shown may still be on their way
  else if (topicsOf(store.watch).includes(topic)) takeTelescope(op, topic, data, now);
}

function takeNetwork(op, data, now) {
  if (op === "snap") store.net.clear();
  for (const [id, summary] of Object.entries(data.items ?? {})) store.net.set(id, { ...summary, received: now });
  for (const id of data.gone ?? []) store.net.delete(id);
  for (const [id, ages] of Object.entries(data.ages ?? {})) {
    const summary = store.net.get(id);
    if (summary) store.net.set(id, { ...summary, ...ages, received: now });
  }
}

function takeTelescope(op, topic, data, now) {
  if (topic.startsWith("log")) {
    if (op === "gap") return;
    const lines = op === "snap" ? data : [...data, ...store.log];
    store.log = lines.sort((a, b) => (a.at_utc < b.at_utc ? 1 : a.at_utc > b.at_utc ? -1 : b.number - a.number));
    store.log.length = Math.min(store.log.length, KEPT_LINES);
    return;
  }
  if (op === "snap") {
    store.states.clear();
    store.whole = true;
  }
  for (const [key, entry] of Object.entries(data.states ?? {})) store.states.set(key, { ...entry, since: now - entry.age_s * 1000 });
  for (const [key, [age, utc]] of Object.entries(data.again ?? {})) {
    const entry = store.states.get(key);
    if (entry) Object.assign(entry, { since: now - age * 1000, at_utc: utc });
  }
}
