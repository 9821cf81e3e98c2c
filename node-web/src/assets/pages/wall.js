// For a screen on the wall: every telescope in two words, large, without anything to touch.
import { html } from "../lib.js";
import { Age, Empty, Icon, Priority, PRIORITIES, Words, postureIcon, standing, summaryAge, urgency } from "../parts.js";
import { net } from "../store.js";
import { activity } from "../activity.js";

export function Wall() {
  const telescopes = [...net.value.values()].filter((one) => !one.shared).sort((a, b) => urgency(a) - urgency(b) || a.id.localeCompare(b.id));
  if (!telescopes.length) return html`<${Empty} icon="scope" title="No telescope yet" />`;
  return html`<h1 class="vh" tabindex="-1">Wall</h1><div class="wall">${telescopes.map((summary) => {
    const now = standing(summary);
    const level = urgency(summary, now);
    return html`<section class="card tile" key=${summary.id} data-level=${level <= 3 ? `p${level}` : null} aria-label=${summary.id}><div class="row between"><span class="big"><${Icon} name=${postureIcon(now.posture)} /> ${summary.telescope_id}</span>${level <= 3 && html`<${Priority} word=${PRIORITIES[level - 1]} />`}</div><${Words} now=${now} lg /><p>${activity(summary, now)[0]}</p><${Age} s=${() => summaryAge(summary)} worth=${now.worth} after=" ago" /></section>`;
  })}</div>`;
}
