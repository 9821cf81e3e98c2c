// Who is signed in; asked again when the link is lost, because the session may be over.
import { signal } from "./lib.js";
import { forgetPicture } from "./picture.js";

/** The answer of `/api/v1/me`, or null. */
export const me = signal(null);

/** The rights from the least to the greatest, each of which contains those before it. */
export const RIGHTS = { viewer: "reads everything but secrets", observer: "also closes, and writes drafts", operator: "also opens, starts, puts schedules in force, answers alerts", engineer: "also overrides limits, reads the audit; of all telescopes: changes users, ends sessions of others" };

/** Has this person a right at a telescope, `site/telescope`? Until the server has said who it is, yes: it refuses what must not be. */
export function may(right, id) {
  const words = Object.keys(RIGHTS);
  return !me.value || (me.value.rights ?? []).some((grant) => {
    const [word, where = "*"] = String(grant).split(":");
    return words.indexOf(word) >= words.indexOf(right) && (where === "*" || where === id || (where.endsWith("/*") && id.startsWith(where.slice(0, -1))));
  });
}

/** May this person change users? */
export const isEngineer = () => (me.value?.rights ?? []).includes("engineer");

/** Asks who is signed in; where nobody is, loads the address again, which is the login page then. */
export async function askUser() {
  try {
    const response = await fetch("/api/v1/me");
    if (response.status === 401) {
      await forgetPicture();
      location.reload();
    }
    if (response.ok) me.value = await response.json();
  } catch {
    // The server is away; the page shows that itself.
  }
}

/** The link is lost: perhaps the session is over. */
export const forgetUser = () => askUser();

/** Ends the session. */
export async function leave() {
  await fetch("/api/v1/logout", { method: "POST" });
  await forgetPicture();
  location.reload();
}
