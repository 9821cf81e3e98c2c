// Who is logged in: shown with a way out, and asked again when the link is lost, because the session may be over.
import { h, show } from "./dom.js";

/** Asks who is logged in; where nobody is, loads the address again, which is the login page then. */
export async function askUser() {
  try {
    const response = await fetch("/api/v1/me");
    if (response.status === 401) location.reload();
    if (!response.ok) return;
    const me = await response.json();
    show(document.getElementById("user"), me.way === "session" && [me.name, " ", h("button", { onclick: leave }, "Log out")],
      me.insecure_open && h("span", { class: "tag high" }, "▲ OPEN TO EVERYBODY"));
  } catch {
    // the server is away; the page shows that itself
  }
}

async function leave() {
  await fetch("/api/v1/logout", { method: "POST" });
  location.reload();
}
