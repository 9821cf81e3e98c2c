// Reads and commands over HTTP; every failure is a sentence.
import { useEffect, useRef, useSignal } from "./lib.js";

/** What a problem document says, with its status. */
export class Failure extends Error {
  constructor(status, problem) {
    super(problem?.detail || problem?.title || `The server answered ${status}.`);
    Object.assign(this, { status, code: problem?.code, problem });
  }
}

/** One request for JSON. */
export async function ask(path, options) {
  let response;
  try {
    response = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Failure(0, { detail: "The server does not answer." });
  }
  const body = /json/.test(response.headers.get("content-type") ?? "") ? await response.json() : null;
  if (!response.ok) throw new Failure(response.status, body);
  return body;
}

/**
 * The answer to a GET while a component is shown: `{ data, error, at, loading, again }`. Asked anew when the path changes, and every `everyS`
 * seconds; a failure keeps the old data, beside `error`. `at` is this browser's time of the answer (ms, monotonic).
 */
export function useGet(path, everyS = 0) {
  const state = useSignal({ data: null, error: null, at: null, loading: true });
  const asked = useRef(null);
  const run = async () => {
    if (!path) return;
    asked.current?.abort();
    const mine = new AbortController();
    asked.current = mine;
    state.value = { ...state.peek(), loading: true };
    try {
      const data = await ask(path, { signal: mine.signal });
      if (data === null || data === undefined) throw new Failure(200, { detail: "The server's answer is empty." });
      if (asked.current === mine) state.value = { data, error: null, at: performance.now(), loading: false };
    } catch (error) {
      if (error.name !== "AbortError" && asked.current === mine) state.value = { ...state.peek(), error, loading: false };
    }
  };
  useEffect(() => {
    state.value = { data: null, error: null, at: null, loading: true };
    run();
    const timer = everyS ? setInterval(() => document.visibilityState === "visible" && run(), everyS * 1000) : 0;
    return () => {
      clearInterval(timer);
      asked.current?.abort();
    };
  }, [path, everyS]);
  return { ...state.value, again: run };
}

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
