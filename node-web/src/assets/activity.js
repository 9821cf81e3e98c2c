// What a telescope does, in words for a title.
import { duration } from "./format.js";
import { inputWords } from "./inputs.js";
import { link } from "./store.js";

/** What a telescope does, in a title and a sentence. */
export function activity(summary, now) {
  if (now.stopped) return ["Stopped", now.stopped.text];
  if (!now.fresh && link.value !== "live") return ["Not known without a link", `Last known: ${summary.now || "nothing under way"}.`];
  if (!now.fresh) return [now.never ? "Nothing received" : "Observatory node silent", [summary.now, ...now.domes].filter(Boolean).join(". ")];
  const [first, ...more] = summary.activity ?? [];
  if (first) return [`${sentence(first.action)} ${first.object ?? ""}`.trim(), [first.step, more.length && `and ${more.length} more`].filter(Boolean).join(", ")];
  const { reasons = [], time_to_safe_s: wait } = summary.safety ?? {};
  // The words of the server, which `starmesh status` prints too.
  const cause = sentence(summary.now || "nothing under way");
  return [cause, now.safety !== "safe" && reasons.length ? `${sentence(inputWords(reasons[0].input))}: ${reasons[0].why}${wait ? `. Opens in ${duration(wait)} at the earliest` : ""}.` : ""];
}
const sentence = (word) => { const plain = String(word).replaceAll("_", " "); return { object: "Observing" }[word] ?? plain[0].toUpperCase() + plain.slice(1); };
