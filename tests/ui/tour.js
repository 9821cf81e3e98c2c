// Makes the pictures of docs: `node tests/ui/tour.js`; with a folder, `node tests/ui/tour.js FOLDER`, every page there, in three themes and two widths, to be
// looked at beside the design. From a recorded bus, so that they show the same night each time.
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { everyAddress, launch, newPage, settled, startRecorded } from "./browser.js";
import { network } from "./recorded/network.js";

const docs = join(import.meta.dirname, "../../docs");
const WIDE = { width: 1280, height: 860 };
const PHONE = { width: 390, height: 844 };
const id = "demo/alpha";
/** File, address, size, theme. */
const PICTURES = [
  ["page.png", `/t/${id}`, { width: 1280, height: 1250 }, "dark"], ["screenshots/network.png", "/", { width: 1280, height: 1000 }, "dark"], ["screenshots/alerts.png", "/alerts", { width: 1280, height: 620 }, "light"],
  ["screenshots/weather.png", "/t/ridge/gamma/weather", WIDE, "dark"], ["screenshots/guiding.png", `/t/${id}/guiding`, WIDE, "dark"], ["screenshots/controls.png", `/t/${id}/controls`, WIDE, "light"],
  ["screenshots/schedule.png", `/t/${id}/schedule`, { width: 1280, height: 1120 }, "light"], ["screenshots/report.png", `/t/${id}/report`, WIDE, "light"], ["screenshots/phone-network.png", "/", PHONE, "dark"], ["screenshots/phone-telescope.png", "/t/ridge/delta", PHONE, "dark"], ["screenshots/phone-night.png", `/t/${id}/weather`, PHONE, "night"],
];

const all = process.argv[2];

/** The page as it is once everything of it is there. */
async function shown(page, address, theme) {
  await page.goto(`${bus.url}${address}?theme=${theme}`);
  await settled(page);
  await page.waitForFunction(() => [...document.images].every((image) => image.loading === "lazy" || image.naturalWidth > 0) && document.fonts.status === "loaded");
}

/** Every page, whole. */
async function everything(page) {
  mkdirSync(all, { recursive: true });
  await page.goto(bus.url);
  await settled(page);
  for (const address of await everyAddress(page)) {
    for (const [name, size, themes] of [["wide", WIDE, ["dark", "light", "night"]], ["phone", PHONE, ["dark", "night"]]]) {
      await page.setViewportSize(size);
      for (const theme of themes) {
        await shown(page, address, theme);
        // What is read when it comes into view.
        await page.evaluate(() => document.querySelector('[data-testid="nights"]')?.scrollIntoView());
        await page.waitForLoadState("networkidle");
        await page.evaluate(() => scrollTo(0, 0));
        const file = `${address.replace(/^\/(t\/demo\/alpha)?\/?/, (start) => (start.length > 1 ? "telescope-" : "")).replaceAll("/", "-") || "network"}-${name}-${theme}.png`;
        await page.screenshot({ path: join(all, file), fullPage: true });
        console.log(file);
      }
    }
  }
}

const bus = await startRecorded();
const browser = await launch();
try {
  await network(bus);
  mkdirSync(join(docs, "screenshots"), { recursive: true });
  const page = await newPage(browser);
  if (all) await everything(page);
  else for (const [file, address, size, theme] of PICTURES) {
    await page.setViewportSize(size);
    await shown(page, address, theme);
    if (address === `/t/${id}`) await page.locator('[data-testid="night"] .b-next').first().waitFor();
    if (address.endsWith("/schedule")) {
      await page.getByRole("button", { name: "Edit a draft" }).click();
      await page.locator('[data-testid="draft-bar"][data-row="5"] .body').press("Shift+ArrowRight");
      await page.getByTestId("findings").waitFor();
    }
    if (address === "/") await page.locator('[data-testid="tile"][data-telescope="ridge/delta"][data-level="p1"]').waitFor();
    await page.screenshot({ path: join(docs, file) });
    console.log(`docs/${file}`);
  }
} finally {
  await browser.close();
  await bus.end();
}
