// Who is signed in; asked again when the link is lost, because the session may be over.
import { signal } from "./lib.js";
import { forgetPicture } from "./picture.js";

/** The answer of `/api/v1/me`, or null. */
export const me = signal(null);

/** The rights from the least to the greatest, each of which contains those before it. */
export const RIGHTS = { viewer: "reads everything but secrets", observer: "also closes, and writes drafts", operator: "also opens, starts, puts schedules in force, answers alerts", engineer: "also overrides limits, reads the audit; of all telescopes: changes users, ends sessions of others" };

/** The text of a grant, whatever the server gave. */
export const grantText = (grant) => (typeof grant === "string" ? grant : JSON.stringify(grant) ?? "");

/** The right and the telescopes of a grant such as `operator:paranal/*`; no telescopes are all of them. */
export const split = (grant) => { const [right, where = ""] = grantText(grant).split(":"); return { right, where }; };

/** Does one of these grants give all that this one does? */
export function isWithin(grant, grants) {
  const wanted = split(grant);
  const rank = ({ right }) => Object.keys(RIGHTS).indexOf(right);
  return grants.map(split).some((own) => rank(own) >= rank(wanted) && (own.where === "" || own.where === wanted.where || (own.where.endsWith("/*") && wanted.where.startsWith(own.where.slice(0, -1)))));
}

/** Has this person a right at a telescope, `site/telescope`? Until the server has said who it is, yes: it refuses what must not be. */
export const may = (right, id) => !me.value || isWithin(`${right}:${id}`, me.value.rights ?? []);

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
