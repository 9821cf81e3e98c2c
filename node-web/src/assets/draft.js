// A draft of a schedule: its text, what was done to it and can be undone, and the one that the server stores for all who edit. What is not stored yet survives
// a reload in this tab; where two people changed it, both texts are kept until one of them decides.
import { computed, signal } from "./lib.js";
import { Failure, ask, command } from "./api.js";
import { difference, rowsOf } from "./rowtext.js";

export const base = (id) => `/api/v1/telescopes/${id}/schedule`;
const JSONL = { "Content-Type": "application/jsonl" };
const MOST_STEPS = 100;
/** The longest text that the server takes, bytes. */
const MOST_BYTES = 1_000_000;

/** Where this tab keeps the draft of a telescope that is not stored. */
const IN_TAB = "draft ";

/** With the tab ends what it keeps: the browser asks first. */
addEventListener("beforeunload", (event) => {
  try {
    if (Object.keys(sessionStorage).some((name) => name.startsWith(IN_TAB))) event.preventDefault();
  } catch {
    // Nothing is kept where there is no such place.
  }
});

/** A text of a schedule with its ETag: the one in force, or a version of before. */
export async function textAt(path) {
  const response = await fetch(path, { headers: { Accept: "application/jsonl" } }).catch(() => { throw new Failure(0, { detail: "The server does not answer." }); });
  if (!response.ok) throw new Failure(response.status, await response.json().catch(() => null));
  return { text: await response.text(), etag: (response.headers.get("etag") ?? "").replaceAll('"', "") };
}

/** The draft of a telescope, as signals and what can be done with it. */
export function draftOf(id) {
  const name = `${base(id)}/drafts/page`;
  const inTab = `${IN_TAB}${id}`;
  const text = signal(null);
  /** The schedule in force, `{ text, etag }`; where there is none an empty one without ETag. */
  const inForce = signal(null);
  /** The ETag of the schedule in force with which the draft was compared last. */
  const basedOn = signal(null);
  /** The draft at the server as it was read or stored last; null where there is none. */
  const stored = signal(null);
  /** The draft of somebody else, stored after this one was read. */
  const theirs = signal(null);
  /** The version that was brought back, `{ text, number }`. */
  let brought = null;
  const past = signal([]);
  const future = signal([]);
  const rows = computed(() => rowsOf(text.value ?? ""));
  const changes = computed(() => (text.value === null || !inForce.value ? [] : difference(inForce.value.text, text.value)));
  const isStored = computed(() => text.value === (stored.value ?? inForce.value)?.text);
  let reading = null;

  const keep = () => {
    try {
      if (isStored.value) sessionStorage.removeItem(inTab);
      else sessionStorage.setItem(inTab, JSON.stringify({ text: text.peek(), etag: stored.peek()?.etag ?? null, basedOn: basedOn.peek() }));
    } catch {
      // Without such a place it lasts as long as the page.
    }
  };
  const kept = () => {
    try {
      const found = JSON.parse(sessionStorage.getItem(inTab));
      return typeof found?.text === "string" ? found : null;
    } catch {
      return null;
    }
  };
  const orElse = (nothing) => (error) => { if (error.status !== 404) throw error; return nothing; };
  const atServer = () => ask(name).catch(orElse(null));
  /** The text is that of the schedule in force. */
  const asInForce = () => {
    text.value = inForce.peek().text;
    basedOn.value = inForce.peek().etag;
    keep();
  };
  /** Reads what is in force; a draft that nobody has changed is the schedule in force, whichever that is. */
  const readInForce = async () => {
    const before = inForce.peek();
    inForce.value = await textAt(base(id)).catch(orElse({ text: "", etag: "" }));
    if (!before || stored.peek() || theirs.peek() || text.peek() !== before.text || past.peek().length + future.peek().length) return;
    asInForce();
  };

  /** Reads it, once; what this tab has kept is newer than what is stored. */
  const read = () => (reading ??= (async () => {
    const [found] = await Promise.all([atServer(), readInForce()]);
    const own = kept();
    const other = own && found && own.etag !== found.etag && own.text !== found.text;
    stored.value = other ? { etag: own.etag } : found;
    theirs.value = other ? found : null;
    basedOn.value = own?.basedOn ?? found?.based_on ?? inForce.peek().etag;
    const next = own?.text ?? (found ?? inForce.peek()).text;
    if (next !== text.peek()) past.value = future.value = [];
    text.value = next;
    keep();
  })().catch((error) => { reading = null; throw error; }));
  /** As the editor opens: what nobody has changed here is read again, since somebody else may have. */
  const begin = () => {
    if (isStored.value && !theirs.peek()) reading = null;
    return read();
  };

  /** Another text, with words for what was done; steps of one `kind` that follow each other are undone together. */
  const edit = (next, what, kind = null) => {
    if (next === text.peek()) return;
    const last = past.peek()[past.peek().length - 1];
    if (!kind || last?.kind !== kind || future.peek().length) past.value = [...past.peek(), { text: text.peek(), what, kind }].slice(-MOST_STEPS);
    future.value = [];
    text.value = next;
    keep();
  };
  const step = (from, to) => () => {
    const last = from.peek()[from.peek().length - 1];
    if (!last) return;
    to.value = [...to.peek(), { ...last, text: text.peek(), kind: null }];
    from.value = from.peek().slice(0, -1);
    text.value = last.text;
    keep();
  };

  /** Stores it; false where somebody else stored another one meanwhile, which is then in `theirs` until that is decided. */
  const store = async () => {
    if (theirs.peek()) return false;
    const sent = text.peek();
    const etag = stored.peek()?.etag;
    try {
      const about = await ask(name, { method: "PUT", headers: { ...JSONL, ...(etag ? { "If-Match": `"${etag}"` } : { "If-None-Match": "*" }) }, body: sent });
      stored.value = { ...about, text: sent };
    } catch (error) {
      if (error.status !== 412) throw error;
      const found = await atServer();
      // Somebody removed it: the next time it is made anew.
      stored.value = found && found.text !== sent ? stored.peek() : found;
      theirs.value = found && found.text !== sent ? found : null;
      if (!found) return store();
    }
    keep();
    return theirs.peek() === null;
  };
  const takeTheirs = () => {
    const found = theirs.peek();
    stored.value = found;
    theirs.value = null;
    edit(found.text, `the draft of ${found.author}`);
    keep();
  };
  /** Stores this one over the other, to which undoing leads. */
  const keepMine = () => {
    const [found, mine] = [theirs.peek(), text.peek()];
    stored.value = found;
    theirs.value = null;
    edit(found.text, "mine over theirs");
    edit(mine, `over the draft of ${found.author}`);
    return store();
  };
  const remove = (etag) => ask(name, { method: "DELETE", headers: { "If-Match": `"${etag}"` } }).catch(orElse(null));
  /** The schedule in force again, and no draft at the server; undoing leads to the one that was stored there, and to this one. */
  const startOver = async () => {
    await readInForce();
    const last = stored.peek();
    if (last) await remove(last.etag);
    if (last?.text) edit(last.text, `the draft of ${last.author}`);
    stored.value = null;
    basedOn.value = inForce.peek().etag;
    edit(inForce.peek().text, "starting over");
    keep();
  };
  /** This text is in force, and no draft any more; one that somebody else has stored stays. */
  const ended = async (sent) => {
    const last = stored.peek();
    stored.value = null;
    past.value = future.value = [];
    await readInForce();
    asInForce();
    if (last?.text === sent) await remove(last.etag);
  };
  const bring = (old, number) => {
    brought = { text: old, number };
    edit(old, `version ${number}`);
  };
  /** Why it is to be activated, as far as that is known. */
  const reason = () => (brought?.text === text.value ? `back to version ${brought.number}` : "");
  const upload = async (file) => {
    if (file.size > MOST_BYTES) throw new Error(`${file.name} has ${file.size} bytes; a schedule that is put over the network has at most ${MOST_BYTES}.`);
    const bytes = await file.arrayBuffer();
    let read;
    try {
      read = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
    } catch {
      throw new Error(`${file.name} is no text in UTF-8; save it as UTF-8, and upload it again.`);
    }
    edit(read, `upload of ${file.name}`);
  };
  /** Puts this very text in force in the place of the one with the ETag `instead`; gives the command. Whoever edits next begins with what is in force. */
  const activate = async (why, instead) => {
    const sent = text.peek();
    const given = await command(id, "put-schedule", { reason: why, waitS: 10, text: sent, ...(instead && { instead_of: instead }) })
      .catch(async (error) => { if (error.status === 412) await readInForce(); throw error; });
    if (given.state === "done") await ended(sent).catch(() => {});
    return given;
  };
  return { text, inForce, basedOn, stored, theirs, past, future, rows, changes, isStored, read, begin, readInForce, edit, undo: step(past, future), redo: step(future, past), store, takeTheirs, keepMine, startOver, bring, reason, upload, activate, seen: () => { basedOn.value = inForce.peek().etag; keep(); } };
}
