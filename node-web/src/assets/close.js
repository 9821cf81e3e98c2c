// Closing: two touches away on every page. The order is done when the shutter reads closed, and the page waits for that.
import { html, signal } from "./lib.js";
import { ask, command } from "./api.js";
import { Dialog, Icon } from "./parts.js";

/** The telescope whose dialog is open, or null. */
const asked = signal(null);
/** Messages at the edge of the page. */
const notes = signal([]);

/** Shows a message for some seconds; returns a function that changes it. */
export function note(text, stays = false) {
  const entry = { id: Math.random(), text };
  const change = (after, ends = true) => {
    notes.value = notes.value.map((other) => (other.id === entry.id ? { ...other, text: after } : other));
    if (ends) setTimeout(() => { notes.value = notes.value.filter((other) => other.id !== entry.id); }, 12000);
  };
  notes.value = [...notes.value, entry];
  if (!stays) change(text);
  return change;
}

/** Does it, and says what came of it. */
export async function act(text, work, after) {
  try {
    await work();
    note(text);
    after();
  } catch (error) {
    note(error.message);
  }
}

/** The button that asks; filled where closing is the first thing to do. */
export const CloseButton = ({ id, filled = true, sm, xl, named, cls = "" }) => html`<button type="button" class=${`btn ${filled ? "close" : "soft"} ${sm ? "sm" : ""} ${xl ? "xl" : ""} ${cls}`} data-testid="close" aria-label=${`Close ${id}`}
  onClick=${() => { asked.value = id; }}><${Icon} name="closed" /><span>Close${named ? ` ${id.split("/")[1]}` : ""}</span></button>`;

async function close(id) {
  asked.value = null;
  const say = note(`${id}: close is being sent …`, true);
  let state = null;
  try {
    state = await command(id, "close", { reason: "closed at the page" });
    while (["sent", "accepted"].includes(state.state)) {
      say(`${id}: ${state.state === "sent" ? "close is sent; nobody has answered yet" : "close is accepted; the shutter is not yet verified closed"} …`, false);
      await new Promise((resolve) => { setTimeout(resolve, 1000); });
      state = await ask(`/api/v1/commands/${state.id}`);
    }
    say(state.state === "done" ? `${id} is verified closed.` : `${id} is NOT verified closed: ${state.state}. ${state.detail ?? ""} Look at the telescope's page.`);
  } catch (error) {
    const said = state ? "close was accepted, and what became of it cannot be read" : [403, 422].includes(error.status) ? "close is REFUSED" : "the close order may not have arrived";
    say(`${id}: ${said}: ${error.message} Look at the telescope's page${state ? "." : `, or use: starmesh order ${id} close`}`);
  }
}

/** The dialog and the messages; shown once, by the shell. */
export function Closing() {
  const id = asked.value;
  const leave = () => { asked.value = null; };
  return html`${id && html`<${Dialog} key=${id} label=${`Close ${id} now?`} close=${leave}>
      <h2>Close ${id.split("/")[1]} now?</h2>
      <p class="m">Ends the running row, closes the dome, then parks the mount and closes the cover. It stays closed until somebody orders <b>start</b>.</p>
      <ul class="locks"><li><${Icon} name="check" />Needs no unlock</li><li><${Icon} name="check" />The dome closes even if this page goes away</li></ul>
      <div class="acts"><button type="button" class="btn soft" onClick=${leave}><span>Cancel</span></button>
        <button type="button" class="btn close" data-first data-testid="close-now" onClick=${() => close(id)}><${Icon} name="closed" /><span>Close now</span></button></div>
    <//>`}
    ${notes.value.length > 0 && html`<div class="toasts" role="status">${notes.value.map((entry) => html`<div class="toast" key=${entry.id}>${entry.text}</div>`)}</div>`}`;
}
