// Start, routes, and the frame around each page.
import { guarded, show, h } from "./dom.js";
import { clock, duration } from "./format.js";
import { skyNow, start, store, watch } from "./link.js";
import { alertCounts, overview, standing } from "./overview.js";
import { telescope } from "./telescope.js";

const at = (id) => document.getElementById(id);
let drawing = false;

/** The telescope that the address names, or null. */
function shown() {
  const found = /^\/t\/([a-z0-9-]+)\/([a-z0-9-]+)$/.exec(location.pathname);
  return found && `${found[1]}/${found[2]}`;
}

function total() {
  const sum = { critical: 0, high: 0, medium: 0, advisory: 0 };
  for (const summary of store.net.values()) {
    for (const priority in sum) sum[priority] += summary.alert_counts?.[priority] ?? 0;
    // a telescope whose two words are alarming counts, alert or no alert
    const { concern } = standing(summary);
    if (concern) sum[concern] = (sum[concern] ?? 0) + 1;
  }
  return sum;
}

/** The frame of the page; its own failure is shown by the watch in theme.js, because `drawn` is not noted then. */
function draw() {
  drawing = false;
  const address = shown();
  const lost = store.link === "lost";
  const sums = total();
  document.body.dataset.link = store.link;
  const summary = address && store.net.get(address);
  const urgent = sums.critical ? ` (critical × ${sums.critical})` : "";
  const sky = skyNow();
  show(at("where"), address && [" › ", address.replace("/", " › ")]);
  show(at("clock"), sky ? `UTC ${lost ? "?" : clock(sky)}` : "", store.sky && store.sky.speed !== 1 && h("span", { class: "word sim" }, ` × ${store.sky.speed}`));
  show(at("link"), h("span", { class: `link-word ${store.link}` }, { live: "live", lost: "LINK LOST", connecting: "connecting" }[store.link]), store.net.size > 0 && [" ", guarded("alerts", () => alertCounts(sums))]);
  show(at("banner"), lost && h("p", { class: "link-lost", "data-link-lost": true }, h("strong", {}, "LINK LOST "),
    store.lostAt ? `since ${clock(store.lostAt)}: what you see is old. Trying again …` : "to the server. Trying again …",
    store.fault && ` ${store.fault}`));
  show(at("main"), address ? guarded("telescope", () => telescope(address, plan)) : guarded("network", overview));
  const telescopes = [...store.net.values()].filter((s) => !s.shared);
  const age = summary && standing(summary).age;
  show(at("foot"), `Starmesh ${store.version} · ${telescopes.filter((s) => standing(s).fresh).length} of ${telescopes.length} telescopes live`, summary && age !== null && ` · received ${duration(age)} ago`);
  document.title = `${lost ? "LINK LOST – " : ""}${address ? `${address.split("/")[1]} – ` : ""}Starmesh${urgent}`;
  document.body.dataset.drawn = String(performance.now());
}

function plan() {
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(drawOrFail);
}

/** A page that cannot be drawn is said to be broken: by the watch in theme.js, which needs nothing of what failed here. */
function drawOrFail() {
  try {
    draw();
  } catch (error) {
    console.warn("the page cannot be drawn", error);
    document.body.dataset.drawn = "-Infinity";
  }
}

function go() {
  watch(shown());
  drawOrFail();
}

document.addEventListener("click", (event) => {
  const link = event.target.closest("a[data-go]");
  if (!link || event.button !== 0 || event.metaKey || event.ctrlKey || event.shiftKey || event.altKey) return;
  event.preventDefault();
  if (link.pathname !== location.pathname) history.pushState(null, "", link.pathname);
  go();
  scrollTo(0, 0);
  document.querySelector("main h1")?.focus({ preventScroll: true });
});
addEventListener("popstate", go);

watch(shown());
start(plan);
drawOrFail();
