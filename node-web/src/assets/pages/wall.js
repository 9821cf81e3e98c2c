// For a screen on the wall: every telescope in two words, large, without anything to touch.
import { html } from "../lib.js";
import { Age, Empty, Icon, Missing, Priority, PRIORITIES, Words, postureIcon, standing, summaryAge, urgency } from "../parts.js";
import { useMissing } from "../devices.js";
import { net } from "../store.js";
import { activity } from "../activity.js";

export function Wall() {
  const telescopes = [...net.value.values()].filter((one) => !one.shared).sort((a, b) => urgency(a) - urgency(b) || a.id.localeCompare(b.id));
  if (!telescopes.length) return html`<${Empty} icon="scope" title="No telescope yet" />`;
  return html`<h1 class="vh" tabindex="-1">Wall</h1><div class="wall">${telescopes.map((summary) => html`<${One} key=${summary.id} summary=${summary} />`)}</div>`;
}

function One({ summary }) {
  const now = standing(summary);
  const level = urgency(summary, now);
  const missing = useMissing(summary, now);
  return html`<section class="card tile" data-level=${level <= 3 ? `p${level}` : null} aria-label=${summary.id}><div class="row between"><span class="big"><${Icon} name=${postureIcon(now.posture)} /> ${summary.telescope_id}</span>${level <= 3 && html`<${Priority} word=${PRIORITIES[level - 1]} />`}</div><${Words} now=${now} lg /><p>${activity(summary, now)[0]} <${Missing} of=${missing} /></p><${Age} s=${() => summaryAge(summary)} worth=${now.worth} after=" ago" /></section>`;
}
