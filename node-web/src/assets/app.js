// Start: which page the address names, and the shell around it.
import { html, render, signal, useEffect } from "./lib.js";
import { Empty } from "./parts.js";
import { pages } from "./pages.js";
import { workOffline } from "./picture.js";
import { follow, route } from "./route.js";
import { Shell } from "./shell.js";
import { net, start, told } from "./store.js";
import { askUser } from "./user.js";

/** Pages that have come, by their entries in the table, and why one has not. */
const come = signal(new Map());
const asked = new Set();

async function load(entry) {
  if (asked.has(entry)) return;
  asked.add(entry);
  let Page;
  try {
    Page = await entry.load();
  } catch (error) {
    console.warn("a page has not come", error);
    Page = () => html`<${Empty} icon="warn" title="This page has not come">The server did not send it. <button class="btn sm" onClick=${() => location.reload()}>Load again</button><//>`;
  }
  come.value = new Map(come.value).set(entry, Page);
}

function Shown({ entry, ...props }) {
  useEffect(() => void load(entry), [entry]);
  const Page = come.value.get(entry);
  return Page ? html`<${Page} ...${props} />` : html`<p class="m">Loading …</p>`;
}

function App() {
  const { page, id } = route.value;
  const known = id ? pages.telescope[page] : pages.network[page];
  const title = id ? `${id.split("/")[1]}${page === "now" ? "" : `, ${known?.title ?? page}`}` : known?.title ?? "Not found";
  let inside;
  if (!known) inside = html`<${Empty} icon="warn" title="There is no such page">${location.pathname} <a href="/">All telescopes</a><//>`;
  else if (id && !net.value.has(id)) {
    inside = told.value || net.value.size ? html`<${Empty} icon="domeq" title=${`Nothing of ${id} was received from the bus`}>A telescope appears here by itself. <a href="/">All telescopes</a><//>` : html`<p class="m">Connecting …</p>`;
  } else inside = html`<${Shown} entry=${known} id=${id} summary=${id ? net.value.get(id) : undefined} key=${location.pathname} />`;
  return html`<${Shell} title=${title}>${inside}<//>`;
}

/** A key that is held presses a button once: the dialog after this one is not answered by it, too. */
function pressOnce(event) {
  if (event.repeat && event.key === "Enter" && event.target.closest?.("button, input")) event.preventDefault();
}

try {
  document.addEventListener("keydown", pressOnce);
  follow();
  askUser();
  start();
  render(html`<${App} />`, document.getElementById("app"));
  workOffline();
} catch (error) {
  console.warn("the page cannot be drawn", error);
  document.body.dataset.drawn = "-Infinity";
}
