// The live socket, and what it has sent: a mirror of what the web node receives. Times are this browser's monotonic milliseconds, sleep included (`elapsed`).
import { elapsed, sleptMs } from "./elapsed.js";
import { computed, signal, useEffect } from "./lib.js";
import { keepPicture, lastPicture } from "./picture.js";
import { forgetUser } from "./user.js";

/** `connecting` before the first message, then `live` or `lost`. */
export const link = signal("connecting");
/** Sky time when the link was lost, ms since 1970. */
export const lostAt = signal(null);
/** Why the last message could not be read, while the page waits for a whole new picture. */
export const fault = signal("");
/** Version of the web node. */
export const version = signal("");
/** Round trip of the newest ping, ms. */
export const roundTrip = signal(null);
/** Each summary of a telescope by `site/telescope`, with `received`. */
export const net = signal(new Map());
/** Has the server told which telescopes there are? Before, that one is missing says nothing. */
export const told = signal(false);
/** Counts up each second, so that what shows an age is drawn again. */
export const tick = signal(0);

const SILENT_MS = 3000;
/** What the socket brings after a pause of so long was on its way while the machine slept. */
const ASLEEP_MS = 30_000;
const RESUMABLE = /^(log|frames)/;
const KEPT_EVENTS = 600;
/** A server that takes a connection and says nothing is given up after this. */
const CONNECTS_MS = 8000;
const KEEP_EVERY_S = 15;
const KEPT_TOPICS = 12;
let sky = null;
let socket = null;
let received = 0;
let tries = 0;
let retry = 0;
let pinged = 0;
let session = "";
let slept = sleptMs();
/** Topic -> { users, data: signal, seq, idle }; idle where all who showed it have left. */
const topics = new Map();
const NO_TOPIC = { users: 0, data: signal(null), seq: null, idle: false };
/** Topics that the server has refused: it takes only so many at a time. They are asked for again when there is room. */
const refused = new Set();
/** How many topics the server takes; it tells that itself. */
let most = 200;
/** Topics of one message, which may not be too long. */
const SUB_AT_ONCE = 50;
/** Topics that were left, newest last, with what they had: pages that a person looked at open without the server, too. */
const left = new Map();

/** Opens the socket and keeps it open. */
export function start() {
  connect();
  const look = () => {
    if (woke()) tick.value += 1;
    else if (elapsed() - received > (link.value === "live" ? SILENT_MS : CONNECTS_MS) && socket) lose();
  };
  setInterval(() => {
    look();
    tick.value += 1;
    if (tick.value % KEEP_EVERY_S === 2) keep();
    if (tick.value % 10 === 1 && socket?.readyState === WebSocket.OPEN) {
      pinged = elapsed();
      socket.send(JSON.stringify({ op: "ping" }));
    }
  }, 1000);
  addEventListener("online", () => socket === null && connect());
  addEventListener("pageshow", look);
  document.addEventListener("visibilitychange", () => {
    look();
    if (document.visibilityState === "hidden") keep();
  });
}

/** Has the machine slept? Then all is old at once, also what the socket still brings, and another socket is opened. */
function woke() {
  const isNew = sleptMs() !== slept || (link.value === "live" && elapsed() - received > ASLEEP_MS);
  if (!isNew) return false;
  slept = sleptMs();
  tries = 0;
  if (socket) lose();
  else connect();
  return true;
}

/** Keeps what is shown, for a page that opens without the server. */
function keep() {
  if (link.peek() !== "live" || !net.peek().size) return;
  const now = [...topics].filter(([, entry]) => entry.data.peek() !== null).map(([name, entry]) => [name, entry.data.peek()]);
  keepPicture({ sky: skyNow(), speed: skySpeed(), version: version.peek(), net: net.peek(), topics: [...left, ...now].slice(-KEPT_TOPICS) });
}

/** No server has answered since the page was loaded: the last picture is shown, and everything in it is old. */
async function restore() {
  const picture = await lastPicture();
  if (!picture || net.peek().size || link.peek() === "live") return;
  const moved = (value, name) => (value instanceof Map ? new Map([...value].map(([key, entry]) => [key, { ...entry, [name]: entry[name] + picture.shift }])) : value);
  for (const [name, data] of picture.topics) {
    left.set(name, moved(data, name.startsWith("tel/") ? "since" : "received"));
    if (topics.get(name)?.data.peek() === null) topics.get(name).data.value = left.get(name);
  }
  sky = { utc: picture.sky, at: picture.page + picture.shift, speed: picture.speed };
  version.value = picture.version;
  lostAt.value = picture.sky;
  net.value = moved(picture.net, "received");
  link.value = "lost";
}

/** Sky time now, ms since 1970, ticking with the server's clock; null before the first message. */
export const skyNow = () => skyAt(elapsed());
const skyAt = (at) => sky && sky.utc + (at - sky.at) * sky.speed;
/** Sky seconds per second. */
export const skySpeed = () => sky?.speed ?? 1;

/** Sky time now in steps of ten seconds of the clock, for what needs no seconds; null before the first message. */
export const moment = computed(() => {
  tick.value; // eslint-disable-line no-unused-expressions
  const step = 10e3 * skySpeed();
  return sky && Math.floor(skyNow() / step) * step;
});

/** Age of something received, s. */
export const ageOf = (entry) => (elapsed() - entry.since) / 1000;
/** The same by the sky's clock, for what counts down in sky time. */
export const skyAgeOf = (entry) => ageOf(entry) * skySpeed();

/** What an age is worth; nothing is fresh while the link is lost. The server judges by the same rule. */
export function quality(age, period) {
  if (age === null || age === undefined) return "lost";
  const judged = period === null || period === undefined ? "fresh" : age > Math.max(5 * period, 15) ? "lost" : age > Math.max(2 * period, 5) ? "stale" : "fresh";
  return link.value === "live" || judged === "lost" ? judged : "stale";
}

/**
 * The data of a topic while a component is shown. Of `tel/SITE/TELESCOPE`: a map of `{ body, at_utc, period_s, since, lostAt }` by key, the last since
 * when a device's link is seen to be lost; of topics with
 * `items`: a map by id; of `log…` and `frames/…`: a list, newest first. `null` until its first message.
 */
export function useTopic(name) {
  const entry = entryOf(name);
  useEffect(() => {
    if (!name) return undefined;
    // To make room it may have been ended since it was drawn.
    const mine = topics.get(name) ?? entry;
    topics.set(name, mine);
    mine.users += 1;
    mine.idle = false;
    if (mine.users === 1) join(name);
    return () => {
      mine.users -= 1;
      mine.idle = mine.users === 0;
      // A page that is left for another of the same telescope keeps its topic.
      setTimeout(() => leave(name, mine) && joinRefused(), 2000);
    };
  }, [name]);
  return entry.data.value;
}

function entryOf(name) {
  if (!name) return NO_TOPIC;
  // What was left is shown again only as old; a server that answers sends it anew.
  if (!topics.has(name)) topics.set(name, { users: 0, data: signal(link.peek() === "lost" ? left.get(name) ?? null : null), seq: null, idle: false });
  topics.get(name).idle = false;
  return topics.get(name);
}

/** For how many more topics there is room at the server, of which one is `net`; below zero it has refused some or will. */
const room = () => most - 1 - (topics.size - refused.size);

/** Subscribes to a topic; where the server has no room, what nobody shows any more goes first. */
function join(name) {
  refused.delete(name);
  const ended = room() < 0 ? [...topics].filter(([other, entry]) => leave(other, entry)) : [];
  subscribe([name]);
  if (ended.length) joinRefused();
}

/** Asks again for what was refused, as far as there is room. */
function joinRefused() {
  const again = [...refused].filter((name) => topics.get(name).users > 0).slice(0, Math.max(0, room()));
  for (const name of again) refused.delete(name);
  subscribe(again);
}

/** Ends a topic that nobody shows any more. */
function leave(name, entry) {
  if (!entry.idle || topics.get(name) !== entry) return false;
  topics.delete(name);
  left.delete(name);
  left.set(name, entry.data.peek());
  if (left.size > KEPT_TOPICS || entry.data.peek() === null) left.delete(entry.data.peek() === null ? name : left.keys().next().value);
  if (!refused.delete(name)) send({ op: "unsub", topics: [name] });
  return true;
}

/** Sends topics; what was received of one before an interruption is not sent again. */
function subscribe(names) {
  for (let i = 0; i < names.length; i += SUB_AT_ONCE) {
    const part = names.slice(i, i + SUB_AT_ONCE);
    const seq = Object.fromEntries(part.filter((name) => RESUMABLE.test(name) && (topics.get(name)?.seq ?? null) !== null).map((name) => [name, topics.get(name).seq]));
    send({ op: "sub", topics: part, ...(session && Object.keys(seq).length && { resume: { session, seq } }) });
  }
}

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function connect() {
  clearTimeout(retry);
  const opened = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/v1/ws`);
  socket = opened;
  received = elapsed();
  opened.onopen = () => {
    if (opened !== socket) return;
    const wanted = [...topics].filter(([, entry]) => entry.users > 0).map(([name]) => name);
    refused.clear();
    for (const name of wanted.slice(most - 1)) refused.add(name);
    subscribe(["net", ...wanted.slice(0, most - 1)]);
  };
  opened.onmessage = (event) => {
    if (opened !== socket || woke()) return;
    const now = elapsed();
    try {
      take(JSON.parse(event.data), now);
    } catch (error) {
      // What was taken may be half of it: begin anew with a whole picture, and let nothing old look live.
      console.warn("a message cannot be read", error);
      fault.value = "What the server sent cannot be read.";
      for (const entry of topics.values()) entry.seq = null;
      lose();
      return;
    }
    received = now;
    tries = 0;
    lostAt.value = null;
    link.value = "live";
    fault.value = "";
  };
  opened.onclose = () => {
    if (opened === socket) lose();
  };
}

function lose() {
  const old = socket;
  socket = null;
  old?.close();
  forgetUser();
  if (link.value === "live") lostAt.value = skyAt(received);
  if (!net.peek().size) restore();
  link.value = link.value === "connecting" && tries < 2 ? "connecting" : "lost";
  const wait = Math.min(8000, 500 * 2 ** tries) * (0.7 + 0.6 * Math.random());
  tries += 1;
  clearTimeout(retry);
  retry = setTimeout(connect, wait);
}

function take(message, now) {
  const { op, topic, data } = message;
  if (message.at_utc) sky = { utc: Date.parse(message.at_utc), at: now, speed: data?.speed ?? sky?.speed ?? 1 };
  if (op === "welcome") {
    version.value = data.version;
    most = data.most_topics ?? most;
    // Numbers of another session say nothing in this one.
    if (session !== (data.session ?? "")) for (const entry of topics.values()) entry.seq = null;
    session = data.session ?? "";
  } else if (op === "pong") roundTrip.value = now - pinged;
  else if (op === "err") {
    if (!topics.has(topic) || room() >= 0) console.warn(data?.detail);
    if (topics.has(topic)) refused.add(topic);
  }
  else if (topic === "net") {
    if (op === "snap") told.value = true;
    if (op === "snap" || data.items || data.gone) net.value = items(net.value, op, data, now);
    // An age goes on in its summary, and no summary changes by it: who shows an age looks at it each second, and the others are not drawn anew.
    for (const [id, ages] of Object.entries(data.ages ?? {})) Object.assign(net.value.get(id) ?? {}, ages, { received: now });
  }
  else if (topics.has(topic)) {
    const entry = topics.get(topic);
    if (message.seq !== undefined) entry.seq = message.seq;
    if (topic.startsWith("tel/")) entry.data.value = states(entry.data.value, op, data, now);
    else if (RESUMABLE.test(topic)) entry.data.value = events(topic, entry.data.value, op, data, message.at_utc);
    else entry.data.value = items(entry.data.value ?? new Map(), op, data, now);
  }
}

function items(before, op, data, now) {
  const after = op === "snap" ? new Map() : new Map(before);
  for (const [id, item] of Object.entries(data.items ?? {})) after.set(id, { ...item, received: now });
  for (const id of data.gone ?? []) after.delete(id);
  return after;
}

function states(before, op, data, now) {
  const after = op === "snap" ? new Map() : new Map(before);
  for (const [key, entry] of Object.entries(data.states ?? {})) after.set(key, { ...entry, since: now - entry.age_s * 1000, lostAt: entry.body?.link?.is === "lost" ? before?.get(key)?.lostAt ?? now : null });
  for (const key of data.gone ?? []) after.delete(key);
  for (const [key, [age, utc]] of Object.entries(data.again ?? {})) {
    if (after.has(key)) after.set(key, { ...after.get(key), since: now - age * 1000, at_utc: utc });
  }
  return after;
}

/** A line in the place of those that were written while the link was cut, and that the server has no longer; no condition of a search hides it. */
const hole = (at_utc) => ({ gap: true, at_utc, number: Number.MAX_SAFE_INTEGER, level: "warn", node: "web", message: "Lines are missing here; the archive has them." });

function events(topic, before, op, data, at) {
  if (op === "gap" && !topic.startsWith("log")) return before;
  const list = op === "snap" ? data : [...(op === "gap" ? [hole(before?.[0]?.at_utc ?? at)] : data), ...(before ?? [])];
  return [...list].sort((a, b) => (a.at_utc < b.at_utc ? 1 : a.at_utc > b.at_utc ? -1 : (b.number ?? 0) - (a.number ?? 0))).slice(0, KEPT_EVENTS);
}
