// Keeps what the page consists of, and the newest image of each telescope, so that it opens without its server. The network goes first:
// nothing here is shown in the place of what a server that answers says. Shows alerts, also while no page is open.
const worker = /** @type {any} */ (self);
/** The page's files; the last picture of the telescopes, with their images, is in a store of its own, which ends with the session. */
const [SHELL, PICTURE] = ["shell", "picture"];
/** A server that hangs is one that does not answer. */
const LONGEST_MS = 6000;

/** Every file that the page needs, by following its own references. */
async function gather() {
  const shell = await caches.open(SHELL);
  const paths = new Set(["/"]);
  for (const path of paths) {
    const response = await fetch(path, { cache: "no-cache" });
    if (!response.ok) throw new Error(`${path}: ${response.status}`);
    await shell.put(path, response.clone());
    if (!/html|javascript|css/.test(response.headers.get("content-type") ?? "")) continue;
    const text = await response.text();
    for (const [, found] of text.matchAll(/(?:from\s*|import\(|src=|href=)"(\/assets\/[^"]+|\.[^"]+\.js)"/g)) paths.add(new URL(found, new URL(path, location.origin)).pathname);
    for (const [, found] of text.matchAll(/url\("?(?!data:)([^")]+)"?\)/g)) paths.add(new URL(found, new URL(path, location.origin)).pathname);
  }
}

/** Only one image of a telescope is kept. */
async function keepImage(request, response) {
  const picture = await caches.open(PICTURE);
  for (const older of await picture.keys(request, { ignoreSearch: true })) if (older.url !== request.url) await picture.delete(older);
  await picture.put(request, response);
}

async function networkFirst(event, key, keep) {
  const stored = () => caches.match(key, { ignoreVary: true });
  const asked = fetch(event.request).then((response) => {
    // A proxy whose server is away answers, too.
    if (response.status >= 502) throw new Error(`the server answered ${response.status}`);
    if (response.ok && !response.redirected) event.waitUntil(keep(response.clone()).catch(() => { /* no room: the page is there all the same */ }));
    return response;
  });
  const late = new Promise((resolve) => { setTimeout(resolve, LONGEST_MS); }).then(stored).then((found) => found ?? asked);
  try {
    return await Promise.race([asked, late]);
  } catch {
    return (await stored()) ?? Response.error();
  }
}

worker.addEventListener("install", (event) => {
  worker.skipWaiting();
  event.waitUntil(gather());
});
worker.addEventListener("activate", (event) => event.waitUntil(worker.clients.claim()));
worker.addEventListener("fetch", (event) => {
  const { request } = event;
  const { origin, pathname } = new URL(request.url);
  if (request.method !== "GET" || origin !== location.origin) return;
  if (/^\/api\/v1\/telescopes\/[^/]+\/[^/]+\/image\.jpg$/.test(pathname)) return void event.respondWith(networkFirst(event, request, (response) => keepImage(request, response)));
  const isPage = request.mode === "navigate" && !/^\/(api|lite|metrics|problems|healthz|readyz|version)/.test(pathname);
  if (!isPage && !pathname.startsWith("/assets/")) return;
  // Each page is the same document. One is kept only from the page itself: the login page and what is not found are no shell.
  const key = isPage ? "/" : pathname;
  event.respondWith(networkFirst(event, key, async (response) => (await caches.open(SHELL)).put(key, response)));
});

// An alert: a later message about the same alert takes the place of this one, and only what is not over makes a sound.
worker.addEventListener("push", (event) => {
  const { title, body, tag, url, silent, stays } = event.data.json();
  event.waitUntil(worker.registration.showNotification(title, { body, tag, silent, renotify: !silent, requireInteraction: stays, icon: "/assets/favicon.svg", data: { url } }));
});
// A page that is open elsewhere stays where it is: somebody may be writing there.
worker.addEventListener("notificationclick", (event) => {
  const { url } = event.notification.data;
  event.notification.close();
  event.waitUntil(worker.clients.matchAll({ type: "window" }).then((pages) => {
    const shown = pages.find((page) => new URL(page.url).pathname === url);
    return shown ? shown.focus() : worker.clients.openWindow(url);
  }));
});
