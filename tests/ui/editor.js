// What the tests of the editor of a schedule share: a recorded telescope whose draft is written on a page that is as new for each test.
import { becomes, fresh, newPage, problemsOf, settled, startRecorded, withBrowser } from "./browser.js";

export const ID = "demo/alpha";
export const WIDE = { width: 1280, height: 1000 };
export const MARKUP = '"><img src=x onerror="window.taken=1"><script>window.taken=1</script>';
/** A text as people write it: comments, a row over several lines, two ways of writing a time. */
export const WRITTEN = `// Tonight, for the supernova.
{"device_name": "camera", "action_type": "open", "action_value": {}, "start_time": "2026-11-27 00:10:00", "end_time": "2026-11-27 08:00:00"}

// The field is crowded:
{"device_name": "camera", "action_type": "object",
 // see the chart
 "action_value": {"object": "SN 2026x", "ra": 24.35, "dec": -45.68, "exptime": 120.0,   "filter": "R"},
 "start_time": "2026-11-27T03:00:00.500Z",   "end_time": "2026-11-27T05:00:00Z"}
// the end`;

export const [bus, browser] = await withBrowser(startRecorded());
const wide = await newPage(browser);
/** What each page must never do, by the page. */
export const problems = new Map([[wide, problemsOf(wide)]]);
/** The page that the test uses, which `begin` chooses. */
export let page = wide;

export const draftPath = () => `${bus.url}/api/v1/telescopes/${ID}/schedule/drafts/page`;
export const area = (on = page) => on.getByLabel("Schedule, rows of JSON");
export const draft = (on = page) => area(on).inputValue();
export const lines = (text) => text.split("\n").filter((line) => line.trim().startsWith("{"));
export const button = (name, on = page) => on.getByRole("button", { name, exact: true });

/** A page as new; the draft of the test before is gone, unless the server `keeps` it. */
export async function begin({ on = wide, viewport = WIDE, keeps = false } = {}) {
  // The other page would go on drawing meanwhile.
  if (page !== on) await fresh(page);
  page = on;
  await fresh(page, { viewport, problems: problems.get(page) });
  if (!keeps) await fetch(draftPath(), { method: "DELETE", headers: { "If-Match": "*" } });
}

/** The same with the editor open. */
export async function open(options = {}) {
  await begin(options);
  await edit();
}

export async function edit(on = page) {
  await on.goto(`${bus.url}/t/${ID}/schedule`);
  await settled(on);
  await button("Edit a draft", on).click();
  await becomes(() => draft(on), (text) => lines(text).length > 0, "the draft has rows");
}

/** Writes a text, and waits until its rows are drawn over the night of the site. */
export async function write(text, rows) {
  await page.locator('[data-testid="draft-line"] .tw-night').waitFor();
  await area().fill(text);
  await becomes(() => page.locator('[data-testid="draft-bar"]').count(), rows, "each row has its bar");
}

// That there is no draft yet is answered as 404, and that somebody changed it as 412.
export const unexpected = () => problems.get(page).filter((one) => !/status of (404|412)/.test(one));
