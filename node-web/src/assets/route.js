// Addresses of the page: `/`, `/alerts`, `/t/SITE/TELESCOPE`, `/t/SITE/TELESCOPE/frames/ID`, and so on.
import { signal } from "./lib.js";

function read() {
  const parts = location.pathname.split("/").filter(Boolean).map(decodeURIComponent);
  const query = new URLSearchParams(location.search);
  if (parts[0] === "t" && parts.length >= 3) {
    const [, site, telescope, page = "now", ...rest] = parts;
    return { page, rest, site, telescope, id: `${site}/${telescope}`, query };
  }
  return { page: parts[0] ?? "network", rest: parts.slice(1), id: null, query };
}

/** What the address asks for. */
export const route = signal(read());

/** Goes to an address of the page. */
export function go(href, { replace = false } = {}) {
  history[replace ? "replaceState" : "pushState"](null, "", href);
  const before = route.value;
  route.value = read();
  if (!replace && (before.page !== route.value.page || before.id !== route.value.id)) {
    scrollTo(0, 0);
    /** @type {HTMLElement} */ (document.querySelector("main h1"))?.focus({ preventScroll: true });
  }
}

/** The address with some of its query changed; `null` removes one. */
export function withQuery(changes) {
  const query = new URLSearchParams(location.search);
  for (const [name, value] of Object.entries(changes)) {
    if (value === null || value === "") query.delete(name);
    else query.set(name, value);
  }
  const text = query.toString();
  return location.pathname + (text ? `?${text}` : "");
}

/** Follows the browser's own buttons, and links without loading the page anew. */
export function follow() {
  addEventListener("popstate", () => { route.value = read(); });
  document.addEventListener("click", (event) => {
    const link = /** @type {any} */ (event.target).closest?.("a[href]");
    if (!link || event.button !== 0 || event.metaKey || event.ctrlKey || event.shiftKey || event.altKey || link.target || link.download) return;
    if (link.origin !== location.origin || link.getAttribute("href").startsWith("#") || /^\/(api|assets|metrics|lite)/.test(link.pathname)) return;
    event.preventDefault();
    go(link.pathname + link.search);
  });
}
