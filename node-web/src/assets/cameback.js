// An alert that comes again: who knew of it before may think that it is over.
import { html } from "./lib.js";
import { useShared } from "./api.js";
import { clock } from "./format.js";
import { tonight } from "./site.js";
import { net } from "./store.js";

/** Raised so often in a night, an alert comes and goes. */
const MANY = 3;
/** The archive is asked once for all alerts of a telescope, and again after so long. */
const EVERY_S = 60;

/** How often an alert of a telescope was raised tonight, by the archive, and what became of it the last time; nothing of one that is raised for the first time. */
export function CameBack({ alert, id }) {
  const summary = net.value.get(id);
  const night = summary && !summary.shared && tonight(summary);
  const answer = useShared(night ? `/api/v1/telescopes/${id}/nights/${night}/alerts` : null, EVERY_S);
  const before = [answer.data?.rows ?? []].flat().map((row) => row?.alert).filter((one) => one?.id === alert.id && Date.parse(one.raised_utc) < Date.parse(alert.raised_utc));
  if (!before.length) return null;
  const last = before.reduce((latest, one) => (Date.parse(one.raised_utc) > Date.parse(latest.raised_utc) ? one : latest));
  const times = before.length + 1;
  return html`<div class="m" data-testid="came-back"><b>${times >= MANY ? "It comes and goes: raised" : "It came back: raised"} ${times} times tonight.</b> Before this from ${clock(last.raised_utc)}${last.cleared_utc ? ` to ${clock(last.cleared_utc)}` : ""}${last.acknowledged_by ? `, acknowledged by ${last.acknowledged_by}` : ""}.</div>`;
}
