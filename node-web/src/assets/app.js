// Start: which page the address names, and the shell around it.
import { html, render } from "./lib.js";
import { Empty } from "./parts.js";
import { pages } from "./pages.js";
import { workOffline } from "./picture.js";
import { follow, route } from "./route.js";
import { Shell } from "./shell.js";
import { link, net, start } from "./store.js";
import { askUser } from "./user.js";

function App() {
  const { page, id } = route.value;
  const known = id ? pages.telescope[page] : pages.network[page];
  const title = id ? `${id.split("/")[1]}${page === "now" ? "" : `, ${known?.title ?? page}`}` : known?.title ?? "Not found";
  let inside;
  if (!known) inside = html`<${Empty} icon="warn" title="There is no such page">${location.pathname} <a href="/">All telescopes</a><//>`;
  else if (id && !net.value.has(id)) {
    inside = link.value === "live" || net.value.size ? html`<${Empty} icon="domeq" title=${`Nothing of ${id} was received from the bus`}>A telescope appears here by itself. <a href="/">All telescopes</a><//>` : html`<p class="m">Connecting …</p>`;
  } else inside = html`<${known.Page} id=${id} summary=${id ? net.value.get(id) : undefined} key=${location.pathname} />`;
  return html`<${Shell} title=${title}>${inside}<//>`;
}

try {
  follow();
  askUser();
  start();
  render(html`<${App} />`, document.getElementById("app"));
  workOffline();
} catch (error) {
  console.warn("the page cannot be drawn", error);
  document.body.dataset.drawn = "-Infinity";
}
