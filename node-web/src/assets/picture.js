// The last picture of the telescopes, kept in this browser: what a page shows, as old, when it opens and no server answers.
import { elapsed } from "./elapsed.js";

const STORE = "picture";
const KEY = "/picture";
/** Has the session ended? Then the page keeps nothing more until it is loaded again. */
let over = false;

/** Where the browser keeps nothing (no TLS, a private window) there is no last picture. */
const store = () => ("caches" in globalThis ? caches.open(STORE) : null);
const asLists = (_, value) => (value instanceof Map ? { map: [...value] } : value);
const asMaps = (_, value) => (Array.isArray(value?.map) && Object.keys(value).length === 1 ? new Map(value.map) : value);

/** Keeps a picture in the place of the one before. */
export async function keepPicture(picture) {
  if (over) return;
  try {
    await (await store())?.put(KEY, new Response(JSON.stringify({ ...picture, kept: Date.now(), page: elapsed() }, asLists), { headers: { "Content-Type": "application/json" } }));
  } catch { /* no room: the page works without */ }
}

/** The picture that was kept, with `shift`: what to add to its times of the page that kept it, ms; null where there is none. */
export async function lastPicture() {
  try {
    const found = await (await store())?.match(KEY);
    if (!found) return null;
    const picture = JSON.parse(await found.text(), asMaps);
    return { ...picture, shift: elapsed() - (Date.now() - picture.kept) - picture.page };
  } catch {
    return null;
  }
}

/** Nobody who is not signed in sees the picture. */
export async function forgetPicture() {
  over = true;
  try {
    if ("caches" in globalThis) await caches.delete(STORE);
  } catch { /* nothing is kept */ }
}

/** Lets the page open without its server. */
export function workOffline() {
  if (!("serviceWorker" in navigator)) return;
  navigator.serviceWorker.register("/assets/service-worker.js", { scope: "/" }).catch((error) => console.info("this page does not open without its server:", error.message));
}
