// What the tests of a network of six telescopes share: a recorded bus on which five more do what its one does, a page that shows them, and alerts of theirs.
import { follow, newPage, problemsOf, startRecorded, withBrowser } from "./browser.js";

export const WIDE = { width: 1280, height: 900 };
export const ALPHA = "demo/alpha";
export const COPIES = ["demo/beta", "ridge/delta", "ridge/epsilon", "ridge/gamma", "ridge/zeta"];

export const [bus, browser] = await withBrowser(startRecorded());
export const recorded = await bus.states();

/** States of a telescope that does what alpha does. */
export const copy = (id) => Object.fromEntries(Object.entries(recorded).filter(([key]) => !key.includes("/node/web/")).map(([key, body]) =>
  [key.replace(ALPHA, id), JSON.parse(JSON.stringify(body).replaceAll(ALPHA, id).replaceAll("observatory/alpha", `observatory/${id.split("/")[1]}`))]));
/** Six telescopes that observe, and need nobody. */
export const calm = (ids = COPIES) => bus.put(Object.assign({}, ...ids.map(copy)));
await calm();

export const page = await newPage(browser, { viewport: WIDE });
export const problems = problemsOf(page);
await page.goto(bus.url);
await page.locator('[data-testid="tile"]').nth(5).waitFor();

export async function open(address, viewport = WIDE) {
  await page.setViewportSize(viewport);
  await follow(page, bus.url + address);
}

export const raised = (change) => ({ raised_utc: "2026-11-27T02:21:10.000000Z", consequence: "Something may happen.", action: "Look at it.", ...change });
export const [stuck, blurred] = [{ id: "dome-not-closed/dome", priority: "critical", cause: "It is half open." }, { id: "focus-failed/camera", priority: "medium", cause: "No curve." }];
export const tell = (id, ...alerts) => bus.put({ [`${id}/observatory/alerts/state`]: { alerts: alerts.map(raised) } });
