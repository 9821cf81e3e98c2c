// Reads and commands over HTTP; every failure is a sentence.
import { signal, useEffect, useMemo } from "./lib.js";

/** What a problem document says, with its status. */
export class Failure extends Error {
  constructor(status, problem) {
    super(problem?.detail || problem?.title || `The server answered ${status}.`);
    Object.assign(this, { status, code: problem?.code, problem });
  }
}

const TRIES = 4;

/** One request for JSON. A question that comes too soon after many others is asked again when the server wants it. */
export async function ask(path, options, tries = TRIES) {
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Failure(0, { detail: "The server does not answer." });
  }
  const body = /json/.test(response.headers.get("content-type") ?? "") ? await response.json() : null;
  if (response.status === 429 && !options?.method && tries > 1) {
    await new Promise((resolve) => { setTimeout(resolve, Math.min(5, Number(body?.retry_after_s) || 1) * 1000); });
    return ask(path, options, tries - 1);
  }
  if (!response.ok) throw new Failure(response.status, body);
  return body;
}

/** Reads an address again and again: its state as a signal, `run()` asks, `stop()` forgets the question that is under way. */
function readerOf(path) {
  const state = signal({ data: null, error: null, at: null, loading: true });
  let asked = null;
  const run = async () => {
    if (!path) return;
    asked?.abort();
    const mine = new AbortController();
    asked = mine;
    state.value = { ...state.peek(), loading: true };
    try {
      const data = await ask(path, { signal: mine.signal });
      if (data === null || data === undefined) throw new Failure(200, { detail: "The server's answer is empty." });
      if (asked === mine) state.value = { data, error: null, at: performance.now(), loading: false };
    } catch (error) {
      if (error.name !== "AbortError" && asked === mine) state.value = { ...state.peek(), error, loading: false };
    }
  };
  return { path, state, run, stop: () => asked?.abort(), users: 0, timer: 0 };
}

/** Calls it every so many seconds while the page is looked at. */
const every = (seconds, run) => (seconds ? setInterval(() => document.visibilityState === "visible" && run(), seconds * 1000) : 0);

/**
 * The answer to a GET while a component is shown: `{ data, error, at, loading, again }`. Asked anew when the path changes, and every `everyS`
 * seconds; a failure keeps the old data, beside `error`. `at` is this browser's time of the answer (ms, monotonic).
 */
export function useGet(path, everyS = 0) {
  const reader = useMemo(() => readerOf(path), [path]);
  useEffect(() => {
    reader.run();
    const timer = every(everyS, reader.run);
    return () => {
      clearInterval(timer);
      reader.stop();
    };
  }, [reader, everyS]);
  return { ...reader.state.value, again: reader.run };
}

/** Readers that several parts of the page share, by their path. */
const shared = new Map();

/** As `useGet`, but one question for all who ask the same; whoever comes back within that time has the answer at once. */
export function useShared(path, everyS) {
  const reader = useMemo(() => {
    if (!shared.has(path)) shared.set(path, readerOf(path));
    return shared.get(path);
  }, [path]);
  useEffect(() => {
    shared.set(path, reader);
    reader.users += 1;
    if (reader.users === 1) {
      const { at } = reader.state.peek();
      if (at === null || performance.now() - at > everyS * 1000) reader.run();
      reader.timer = every(everyS, reader.run);
    }
    return () => {
      reader.users -= 1;
      if (reader.users > 0) return;
      clearInterval(reader.timer);
      setTimeout(() => { if (reader.users === 0 && shared.get(path) === reader) shared.delete(path); }, everyS * 1000);
    };
  }, [reader]);
  return { ...reader.state.value, again: reader.run };
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
