// Reads and commands over HTTP; every failure is a sentence.
import { elapsed, sleptMs } from "./elapsed.js";
import { computed, effect, signal, untracked, useEffect, useMemo, useRef } from "./lib.js";
import { link, quality, tick } from "./store.js";

/** What a problem document says, with its status. */
export class Failure extends Error {
  constructor(status, problem) {
    super(problem?.detail || problem?.title || `The server answered ${status}.`);
    Object.assign(this, { status, code: problem?.code, problem });
  }
}

const TRIES = 4;
/** A question without an answer ends then, s. */
const LONGEST_S = 45;

/** One request for JSON. A question that comes too soon after many others is asked again when the server wants it. */
export async function ask(path, options, tries = TRIES) {
  const { signal, method } = options ?? {};
  const own = new AbortController();
  const leave = () => own.abort(signal.reason);
  if (signal?.aborted) leave();
  signal?.addEventListener("abort", leave, { once: true });
  const late = method ? 0 : setTimeout(() => own.abort(new Failure(0, { detail: `The server has not answered within ${LONGEST_S} s.` })), LONGEST_S * 1000);
  let response, body;
  try {
    response = await fetch(path, { ...options, signal: own.signal });
    body = /json/.test(response.headers.get("content-type") ?? "") ? await response.json() : null;
  } catch {
    if (own.signal.aborted) throw own.signal.reason;
    throw new Failure(0, { detail: response ? "The server's answer cannot be read." : "The server does not answer." });
  } finally {
    clearTimeout(late);
    signal?.removeEventListener("abort", leave);
  }
  if (response.status === 429 && !method && tries > 1) {
    await new Promise((resolve) => { setTimeout(resolve, Math.min(5, Number(body?.retry_after_s) || 1) * 1000); });
    return ask(path, options, tries - 1);
  }
  if (!response.ok) throw new Failure(response.status, body);
  return body;
}

/** Readers of what is shown. */
const live = new Set();
/** It is looked once a second for what is due: nearly due is due. */
const SLACK_MS = 500;
let slept = sleptMs();

/** While the page is looked at, asks what is due, each only once at a time; what was under way when the machine slept is asked anew. */
function look() {
  if (document.visibilityState !== "visible") return;
  const woke = sleptMs() !== slept;
  slept = sleptMs();
  for (const reader of live) if (reader.asked ? woke : reader.due - SLACK_MS <= elapsed()) reader.run();
}

/** Something may be better now: what failed does not wait. */
function hurry() {
  for (const reader of live) if (reader.fails) reader.due = 0;
  look();
}

effect(() => {
  tick.value; // eslint-disable-line no-unused-expressions
  untracked(look);
});
effect(() => { if (link.value === "live") untracked(hurry); });
document.addEventListener("visibilitychange", hurry);
addEventListener("pageshow", hurry);

/**
 * Reads an address again and again: its state as a signal, `run()` asks, in the place of a question that is under way, `stop()` forgets that one. `before` is the state whose
 * data it has at first, `read(path, { signal })` what asks.
 */
function readerOf(path, before, read = ask) {
  const state = signal({ data: before?.data ?? null, error: before?.data ? before.error : null, at: before?.at ?? null, loading: Boolean(path) });
  const run = async () => {
    if (!path) return;
    reader.asked?.abort();
    const mine = new AbortController();
    reader.asked = mine;
    state.value = { ...state.peek(), loading: true };
    let next, isWhole;
    try {
      const data = await read(path, { signal: mine.signal });
      if (data === null || data === undefined) throw new Failure(200, { detail: "The server's answer is empty." });
      next = { data, error: null, at: elapsed(), loading: false };
      isWhole = !reader.whole || reader.whole(data);
    } catch (error) {
      next = { ...state.peek(), error, loading: false };
    }
    if (reader.asked !== mine) return;
    reader.asked = null;
    const { everyS, whole, fails } = reader;
    if (mine.signal.aborted) next = { ...state.peek(), loading: false };
    else if (isWhole) Object.assign(reader, { fails: 0, due: elapsed() + 1000 * (everyS || Infinity) });
    else {
      const [first, most] = everyS && !whole ? [everyS, 120] : [2, 60];
      Object.assign(reader, { fails: fails + 1, due: elapsed() + 1000 * Math.min(most, first * 2 ** fails) });
    }
    state.value = next;
  };
  const worth = computed(() => {
    tick.value; // eslint-disable-line no-unused-expressions
    const { at, error } = state.value;
    return error ? "lost" : quality(at === null ? null : (elapsed() - at) / 1000, reader.everyS || null);
  });
  /** @type {any} */
  const reader = { path, state, worth, run, stop: () => reader.asked?.abort(), asked: null, due: 0, fails: 0, everyS: 0, whole: null, users: 0 };
  return reader;
}

const answerOf = (reader) => ({ ...reader.state.value, worth: reader.worth.value, again: reader.run });

/**
 * The answer to a GET while a component is shown: `{ data, error, at, loading, worth, again }`. Asked anew when the path changes, and every `everyS`
 * seconds while the page is looked at; a failure keeps the old data, beside `error`, and is followed by another try, later each time. `at` is this browser's
 * time of the answer (`elapsed`), `worth` what the data are worth by their age: lost while the last try failed. `keep`: what came from another path stays until
 * the answer from this one. `whole(data)`: as long as it says no, it is asked again, later each time.
 * @param {string} path @param {number} [everyS]
 * @param {{ keep?: boolean, whole?: (data: any) => boolean, read?: (path: string, options: { signal: AbortSignal }) => Promise<any> }} [options]
 */
export function useGet(path, everyS = 0, { keep = false, whole = null, read = ask } = {}) {
  const last = useRef(null);
  const reader = useMemo(() => readerOf(path, keep && path ? last.current?.state.peek() : null, read), [path]);
  last.current = reader;
  Object.assign(reader, { everyS, whole });
  useEffect(() => {
    live.add(reader);
    reader.run();
    return () => {
      live.delete(reader);
      reader.stop();
    };
  }, [reader, everyS]);
  return answerOf(reader);
}

/** Readers that several parts of the page share, by their path. */
const shared = new Map();

/** As `useGet`, but one question for all who ask the same; whoever comes back within that time has the answer at once. */
export function useShared(path, everyS) {
  const reader = useMemo(() => {
    if (!shared.has(path)) shared.set(path, readerOf(path, null));
    return shared.get(path);
  }, [path]);
  reader.everyS = everyS;
  useEffect(() => {
    shared.set(path, reader);
    reader.users += 1;
    live.add(reader);
    if (reader.users === 1 && !reader.asked && (reader.fails || reader.due <= elapsed())) reader.run();
    return () => {
      reader.users -= 1;
      if (reader.users > 0) return;
      live.delete(reader);
      setTimeout(() => { if (reader.users === 0 && shared.get(path) === reader) shared.delete(path); }, everyS * 1000);
    };
  }, [reader]);
  return answerOf(reader);
}

const REPORT_EVERY_S = 60;

/** The report of a night of a telescope; of tonight where no night is named. */
export const useReport = (id, night) => useShared(night ? `/api/v1/telescopes/${id}/nights/${night}/report` : null, REPORT_EVERY_S);

/**
 * Gives a command; the answer is the command as a resource. Its key makes a repeated request act once.
 * @param {string} telescope @param {string} name
 * @param {{ reason?: string, operator?: string, waitS?: number, [parameter: string]: unknown }} [options]
 */
export function command(telescope, name, { reason = "", operator, waitS = 0, ...parameters } = {}) {
  return ask(`/api/v1/telescopes/${telescope}/commands`, {
    method: "POST",
    headers: { "Content-Type": "application/json", "Idempotency-Key": crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}`, ...(waitS && { Prefer: `wait=${waitS}` }) },
    body: JSON.stringify({ command: name, reason, ...(operator && { operator }), parameters }),
  });
}
