// Numbered checks of the pages (checks/telescope.md): a telescope with its night and its sky, weather and safety, guiding, focus; frames are in checks_frames.test.js.
import { test, beforeEach } from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { noteCanvas } from "./known.js";
import { network } from "./recorded/network.js";
import { TEST, addressOf, becomes, follow, near, newPage, startRecorded, text, withBrowser } from "./browser.js";

const ID = "demo/alpha";
const HERE = `/t/${ID}`;
const WIDE = { width: 1280, height: 1000 };
const key = (name) => `${ID}/${name}/state`;
const [MOUNT, DOME, CAMERA, WEATHER] = ["telescope/mount", "dome/dome", "camera/camera", "observingconditions/weather"].map((name) => key(`device/${name}`));
const [SAFETY, NIGHT, GUIDING, FOCUS] = ["safety", "night", "guiding", "focus"].map((name) => key(`observatory/${name}`));
const [{ run: RUN }] = JSON.parse(readFileSync(join(import.meta.dirname, "../../common/contract/golden/v1/observatory.focus.json"), "utf8"));

const [bus, browser] = await withBrowser(startRecorded());
const recorded = await bus.states();
/** What the server says may be changed on its way. */
let alter = (_) => {};
const page = await newPage(browser, { viewport: WIDE });
await page.routeWebSocket(/\/api\/v1\/ws$/, (socket) => {
  const server = socket.connectToServer();
  server.onMessage((message) => {
    const told = JSON.parse(String(message));
    alter(told);
    socket.send(JSON.stringify(told));
  });
});
await page.addInitScript(noteCanvas);
// A hill of 65 degrees in the east; the report and the forecast come as they were recorded.
await page.route(/\/telescopes\/demo\/alpha\/sky$/, async (route) => {
  const response = await route.fetch();
  await route.fulfill({ response, json: { ...(await response.json()), horizon: Array.from({ length: 180 }, (_, i) => [2 * i, 2 * i > 80 && 2 * i < 120 ? 65 : 12]) } });
});
await page.goto(`${bus.url}${HERE}`);
await page.locator('[data-testid="device"]').nth(9).waitFor();

beforeEach(async () => {
  alter = (_) => {};
  await bus.reset();
}, TEST);

const open = async (address) => { if (addressOf(page).pathname !== address) await follow(page, bus.url + address); };
const device = (name) => page.locator(`[data-testid="device"][data-device="${name}"]`);
const sky = () => page.evaluate(() => import("/assets/store.js").then((store) => store.skyNow()));
/** Changes fields of a device. */
const fields = (name, change) => bus.put({ [name]: { ...recorded[name], fields: { ...recorded[name].fields, ...change } } });

test("each device has a row with its state, its age and its period", TEST, async () => {
  await open(HERE);
  const expected = Object.keys(recorded).filter((name) => /^demo\/alpha\/device\/[^/]+\/[^/]+\/state$/.test(name)).map((name) => name.split("/").slice(3, 5).join("/")).sort();
  const rows = () => page.locator('[data-testid="device"]').evaluateAll((all) => all.map((one) => [one.dataset.device, one.children[1].textContent !== "" && one.querySelector("[data-age-s]") !== null, one.lastElementChild.textContent]));
  await becomes(rows, (all) => all.length === expected.length && all.every(([, isTold]) => isTold), "each has a state and an age");
  const all = await rows();
  assert.deepEqual(all.map(([name]) => name).sort(), expected);
  for (const [name, , period] of all) assert.equal(period, `${recorded[key(`device/${name}`)].period_s} s`, name);
});

test("a device that falls silent is stale after two of its periods and lost after five, and the step under way stays", TEST, async () => {
  await open(HERE);
  const now = page.locator('[data-testid="now"]');
  let later = 0;
  alter = ({ data }) => {
    for (const name of [DOME, CAMERA]) {
      if (data?.states?.[name]) data.states[name].age_s += later;
      if (data?.again?.[name]) data.again[name][0] += later;
    }
  };
  const worth = () => Promise.all(["dome/dome", "camera/camera"].map((name) => device(name).getAttribute("data-quality")));
  // One is published each second, for which it is 5 s and 15 s, the other each 5 s.
  for (const [age, expected] of /** @type {const} */ ([[2, ["fresh", "fresh"]], [7, ["stale", "fresh"]], [18, ["lost", "stale"]], [30, ["lost", "lost"]]])) {
    later = age;
    await becomes(worth, expected, `${age} s old`);
    await now.locator(".big", { hasText: "WASP-18" }).waitFor();
  }
  await device("dome/dome").filter({ hasText: "silent" }).waitFor();
  // What the shutter is the observatory node says, and nobody else.
  await page.locator('.scope [data-posture="open"]').first().waitFor();
  await bus.put({ [NIGHT]: { ...recorded[NIGHT], posture: "unknown" } });
  await page.locator('.scope .words[data-posture="unknown"]', { hasText: "DOME UNKNOWN" }).waitFor();
  await now.locator(".big", { hasText: "WASP-18" }).waitFor();
});

test("the bar of an exposure goes on to its end and never back", TEST, async () => {
  await open(HERE);
  const began = (await sky()) - 118_500;
  await page.evaluate((from) => import("/assets/store.js").then(({ skyNow }) => {
    window.bars = [];
    new MutationObserver(() => {
      const bar = document.querySelector('[data-testid="now"] .light i');
      if (bar) window.bars.push([(skyNow() - from) / 1000, parseFloat(bar.style.width)]);
    }).observe(document.querySelector("main"), { subtree: true, attributes: true, childList: true, characterData: true });
  }), began);
  await fields(CAMERA, { exposure: { id: "one", started_utc: new Date(began).toISOString(), exposure_s: 120 } });
  const drawn = await becomes(() => page.evaluate(() => window.bars.slice(window.bars.findIndex(([, width]) => width > 90))), (all) => all.at(-1)?.[1] === 100, "it is full");
  for (const [i, [passed, width]] of drawn.entries()) {
    assert.ok(near(width, Math.min(100, passed / 1.2), 1 / 1.2), `${width} % after ${passed} s of 120`);
    const before = i ? drawn[i - 1][1] : 0;
    assert.ok(width >= before - 0.3, `${width} % after ${before} %`);
  }
  await fields(CAMERA, { exposure: undefined });
  await page.locator('[data-testid="now"] .light').waitFor({ state: "detached" });
});

test("twilights of the timeline are those of the server within 5 s, a row at work stands out, and what was unsafe is a bar with its reason, also by keyboard", TEST, async () => {
  const [from, until] = ["2026-11-27T01:00:00Z", "2026-11-27T01:40:00Z"].map(Date.parse);
  const stop = { verdict: "unsafe", from_utc: new Date(from).toISOString(), until_utc: new Date(until).toISOString(), reasons: ["weather/Humidity: 93 % is above 90 %"] };
  const [first, last] = recorded[SAFETY].intervals;
  await bus.put({ [SAFETY]: { ...recorded[SAFETY], intervals: [first, { ...last, until_utc: stop.from_utc }, stop, { ...last, from_utc: stop.until_utc }] } });
  await open(HERE);
  const line = page.locator('[data-testid="timeline"]');
  const bar = line.locator(".b-stop", { has: page.locator("title", { hasText: "weather/Humidity: 93 % is above 90 %" }) });
  await bar.waitFor();
  const found = await page.evaluate(async (id) => {
    const [{ night, place }, { twilight }] = await Promise.all([fetch(`/api/v1/telescopes/${id}/sky`).then((r) => r.json()), import("/assets/astro.js")]);
    const one = /** @type {HTMLElement} */ (document.querySelector('[data-testid="timeline"]'));
    const [t0, t1] = [Number(one.dataset.from), Number(one.dataset.to)];
    const bands = twilight(t0, t1, { lat: place.latitude_deg, lon: place.longitude_deg });
    return { night, t0, t1, ends: bands.slice(1).map((band) => [band.kind, band.from]), drawn: [...one.querySelectorAll("rect[class^=tw-]")].map((band) => band.getAttribute("class").slice(3)), W: one.querySelector("svg").viewBox.baseVal.width };
  }, ID);
  const names = ["sunset", "civil_dusk", "nautical_dusk", "astronomical_dusk", "astronomical_dawn", "nautical_dawn", "civil_dawn", "sunrise"];
  assert.deepEqual(found.drawn, ["day", "civil", "nautical", "astro", "night", "astro", "nautical", "civil", "day"]);
  for (const [i, name] of names.entries()) assert.ok(near(found.ends[i][1], Date.parse(found.night[`${name}_utc`]), 5000), `${name}: ${new Date(found.ends[i][1]).toISOString()} is not ${found.night[`${name}_utc`]}`);
  const x = (t) => 74 + ((t - found.t0) / (found.t1 - found.t0)) * (found.W - 78);
  const [left, width] = await bar.evaluate((one) => ["x", "width"].map((name) => Number(one.getAttribute(name))));
  assert.ok(near(left, x(from), 1) && near(left + width, x(until), 1), `${left} + ${width} is not ${x(from)} to ${x(until)}`);
  await line.locator(".b-run title", { hasText: /^WASP-18, \d+ frames$/ }).waitFor({ state: "attached" });
  // No mouse is over it.
  await page.locator(".tl.look").focus();
  const said = page.locator(".tl .time-tools .cut");
  const seen = new Set();
  for (let i = 0; i < 45; i += 1) {
    await page.keyboard.press("ArrowLeft");
    seen.add(await text(said));
  }
  await becomes(() => [...seen].some((one) => /unsafe: weather\/Humidity: 93 % is above 90 %/.test(one)) && [...seen].some((one) => /NGC 253, 20 frames/.test(one)), true, [...seen].join("\n"));
});

test("the sky map has the telescope where it points, says when that is below the horizon, and a ring of 30 degrees around the Moon", TEST, async () => {
  await open(HERE);
  const card = page.locator('[data-testid="sky"]');
  const aim = () => card.locator(".aim circle").evaluate((one) => [Number(one.getAttribute("cx")), Number(one.getAttribute("cy"))]);
  const at = (altitude, azimuth) => [180 - ((90 - altitude) / 90) * 150 * Math.sin((azimuth * Math.PI) / 180), 180 - ((90 - altitude) / 90) * 150 * Math.cos((azimuth * Math.PI) / 180)];
  for (const [altitude, azimuth, isBelow] of /** @type {const} */ ([[60, 100, true], [60, 300, false], [11, 200, true]])) {
    await fields(MOUNT, { altitude_deg: altitude, azimuth_deg: azimuth });
    await becomes(aim, ([x, y]) => near(x, at(altitude, azimuth)[0], 1) && near(y, at(altitude, azimuth)[1], 1), `${altitude} ${azimuth}`);
    await becomes(async () => /below the horizon/.test(await text(card.locator(".read"))), isBelow, `${altitude} ${azimuth}`);
  }
  const moon = await page.evaluate(async () => {
    const [{ html, render }, { SkyMap }, astro] = await Promise.all(["lib", "sky", "astro"].map((name) => import(`/assets/${name}.js`)));
    const site = { lat: -24.6, lon: -70.4 };
    let now = Date.parse("2026-11-27T02:00:00Z");
    while (astro.altaz(astro.moon(now), now, site).alt < 30) now += 6e5;
    const place = document.createElement("div");
    render(html`<${SkyMap} mount=${null} dome=${null} site=${site} now=${now} />`, place);
    const { alt, az } = astro.altaz(astro.moon(now), now, site);
    return { alt, az, ring: ["cx", "cy", "r"].map((name) => Number(place.querySelector("circle.lim").getAttribute(name))) };
  });
  const [mx, my] = at(moon.alt, moon.az);
  assert.ok(near(moon.ring[0], mx, 1) && near(moon.ring[1], my, 1) && near(moon.ring[2], (30 / 90) * 150, 0.5), String(moon.ring));
});

test("what a device does not tell is missing alone", TEST, async () => {
  await open(HERE);
  const row = device("telescope/mount");
  await row.filter({ hasText: /tracking.*RA.*Dec.*alt.*az.*pier/ }).waitFor();
  await fields(MOUNT, { altitude_deg: { no_data: "not implemented" } });
  await becomes(() => text(row), (told) => /tracking.*RA.*Dec.*az.*east pier/.test(told) && !/ alt /.test(told), "all but the altitude");
  await page.locator('[data-testid="sky"] .read', { hasText: /Alt —.*Moon/ }).waitFor();
  await becomes(() => page.locator('[data-testid="device"]').count(), 10);
});

test("a property that the page does not know has its name, its value and its unit, and no line crosses a gap of its past", TEST, async () => {
  await bus.put({ [MOUNT]: { ...recorded[MOUNT], readings: { ...recorded[MOUNT].readings, Obliquity: { value: 4.25, unit: "gon", at_utc: recorded[MOUNT].at_utc } } } });
  await open(`${HERE}/devices/telescope/mount`);
  await page.locator('[data-reading="Obliquity"]', { hasText: "Obliquity4.25 gon" }).waitFor();
  const at = (minute) => `2026-11-27T02:${minute}:00Z`;
  const series = { points: [10, 11, 30, 31].map((minute) => ({ at_utc: at(minute), mean: 5 })), gaps: [{ from_utc: at(11), to_utc: at(30) }] };
  assert.deepEqual(await page.evaluate((one) => import("/assets/chart.js").then(({ columns, pointsOf }) => columns([{ points: pointsOf(one) }])[1]), series), [5, 5, null, 5, 5]);
});

test("two telescopes of a site never show each other's values, in a thousand random updates", TEST, async () => {
  await network(bus);
  const states = await bus.states();
  const spans = { "demo/alpha": [10_000, 20_000], "demo/beta": [30_000, 40_000] };
  let seed = 20261127;
  const random = () => { seed = (seed * 1103515245 + 12345) % 2 ** 31; return seed / 2 ** 31; };
  const update = () => Object.fromEntries(Object.entries(spans).flatMap(([id, [low, high]]) => {
    const position = Math.floor(low + random() * (high - low));
    return [["focuser/focuser", { position }], ["rotator/rotator", { mechanical_deg: position / 1000 }]].map(([name, change]) => { const one = `${id}/device/${name}/state`; return [one, { ...states[one], fields: { ...states[one].fields, ...change } }]; });
  }));
  await bus.put(update());
  for (const [id, [low, high]] of Object.entries(spans)) {
    await open(`/t/${id}`);
    // From the first update on that the page has received.
    await becomes(() => page.locator('[data-device="focuser/focuser"] .full .nw:first-child b, [data-device="rotator/rotator"] .full .nw:nth-child(2) b').allTextContents(), (all) => all.length === 2 && all.every((one) => parseFloat(one) >= low / 1000 && !/24 980/.test(one)), "what is put for this telescope");
    await page.evaluate(() => {
      window.seen = new Set();
      const look = () => { for (const one of document.querySelectorAll('[data-device="focuser/focuser"] .full .nw:first-child b, [data-device="rotator/rotator"] .full .nw:nth-child(2) b')) window.seen.add(one.textContent); };
      new MutationObserver(look).observe(document.querySelector("main"), { subtree: true, childList: true, characterData: true });
    });
    let sent;
    for (let i = 0; i < 125; i += 1) await bus.now((sent = update()));
    await bus.put((sent = update()));
    const [position, turned] = ["focuser/focuser", "rotator/rotator"].map((name) => Object.values(sent[`${id}/device/${name}/state`].fields));
    await device("focuser/focuser").filter({ hasText: String(position[0]).replace(/(\d+)(\d{3})$/, "$1 $2") }).waitFor();
    await device("rotator/rotator").filter({ hasText: `${turned[1].toFixed(2)}° mechanical` }).waitFor();
    const seen = (await page.evaluate(() => [...window.seen])).filter((one) => /^[\d. ]+°?$/.test(one)).map((one) => (one.endsWith("°") ? 1000 * parseFloat(one) : Number(one.replace(" ", ""))));
    assert.ok(seen.length > 2, `${seen}`);
    assert.deepEqual(seen.filter((one) => one < low - 5 || one > high + 5), [], id);
  }
});

/** The panels of a chart: what is drawn on each, and where on it its values can stand. */
const panels = () => page.locator('[data-testid="chart"]').first().locator(".panel").evaluateAll((all) => all.flatMap((panel) => {
  const [canvas, over] = ["canvas", ".u-over"].map((one) => /** @type {any} */ (panel.querySelector(one)));
  if (!over) return [];
  const [outer, inner] = [canvas, over].map((one) => one.getBoundingClientRect());
  return [{ name: panel.querySelector(".m").textContent, told: canvas.told ?? [], top: inner.top - outer.top, bottom: inner.bottom - outer.top, right: inner.right - outer.left }];
}));
const panel = async (name) => (await panels()).find((one) => one.name === name);

test("each limit of the weather is a line within its chart, however far the values are, and a chart says its figures in words", TEST, async () => {
  const inputs = recorded[SAFETY].inputs.map((one) => (one.input === "weather/Humidity" ? { ...one, limits: [70, 80, 98].map((upper) => ({ upper, dwell_s: 900 })) } : one));
  await bus.put({ [SAFETY]: { ...recorded[SAFETY], inputs } });
  await open(`${HERE}/weather`);
  const wanted = await page.evaluate((all) => import("/assets/inputs.js").then(({ PARAMETERS, limitsOf }) => PARAMETERS.map(([property, , label]) => [label, limitsOf(all, "weather", property).map(({ text }) => text)]).filter(([, texts]) => texts.length)), inputs);
  assert.ok(wanted.length >= 3 && wanted.some(([, texts]) => texts.length === 3), JSON.stringify(wanted));
  for (const [label, texts] of wanted) {
    const found = await becomes(() => panel(label), (one) => one && texts.every((wish) => one.told.some(({ text: said }) => said === wish)), `${label}: ${texts}`);
    const lines = [...new Set(found.told.filter(({ dashed }) => dashed !== undefined).map(({ dashed }) => Math.round(dashed)))];
    assert.ok(lines.length >= texts.length && lines.every((y) => y >= found.top - 1 && y <= found.bottom + 1), `${label}: ${lines} of ${found.top} to ${found.bottom}`);
  }
  const words = await page.locator('[data-testid="chart"]').first().getAttribute("aria-label");
  assert.match(words, /Wind [\d.]+ m\/s, limit 15\.0 m\/s, from [\d.]+ m\/s to [\d.]+ m\/s; /);
  assert.match(words, /Humidity \d+ %, limit 70 %, limit 80 %, limit 98 %, from \d+ % to \d+ %/);
  await page.getByRole("button", { name: /^Table of values: Wind/ }).waitFor();
});

test("humidity beyond its limit is UNSAFE with its reason, and the time at which it can clear stays while it is counted down to", TEST, async () => {
  const reason = { input: "weather/Humidity", why: "84.0 % is above 80 %", clears_in_s: 1260 };
  const inputs = recorded[SAFETY].inputs.map((one) => (one.input === reason.input ? { ...one, value: "84.0", good: false } : one));
  await open(`${HERE}/weather`);
  const card = page.locator('[data-testid="reasons"]');
  await page.evaluate(() => import("/assets/store.js").then(({ skyNow }) => {
    window.counted = [];
    new MutationObserver(() => {
      const found = /Can clear|(\d\d:\d\d:\d\d), in (\d+) min (\d+) s/.exec(document.querySelector('[data-testid="reasons"] tbody .num')?.textContent ?? "");
      if (found?.[1]) window.counted.push([skyNow(), Date.parse(`2026-11-27T${found[1]}Z`), 60 * Number(found[2]) + Number(found[3])]);
    }).observe(document.querySelector("main"), { subtree: true, childList: true, characterData: true });
  }));
  // The observatory node says it once; what it repeats here would begin to count anew.
  alter = ({ data }) => { if (data?.again) delete data.again[SAFETY]; };
  let n = 0;
  const says = () => bus.put({ [SAFETY]: { ...recorded[SAFETY], verdict: "unsafe", since_utc: new Date(Date.parse("2026-11-27T02:20:00Z") + (n += 1)).toISOString(), reasons: [reason], time_to_safe_s: 1260, inputs }, [NIGHT]: { ...recorded[NIGHT], posture: "closed", actions: [] } });
  await says();
  await card.locator('.words[data-safety="unsafe"]', { hasText: "UNSAFE" }).waitFor();
  await card.locator("tbody tr", { hasText: /Humidity.*84\.0 % is above 80 %.*in 2\d min/ }).waitFor();
  const steps = await becomes(async () => {
    const counted = await page.evaluate(() => window.counted);
    const found = counted.slice(1).map((one, i) => [counted[i], one]).filter(([[, clears], [, later]]) => near(clears, later, 1000));
    // It has become stale before the page counted: it is said again.
    if (!/in \d/.test(await card.locator("tbody .num").textContent())) await says();
    return found;
  }, (found) => found.some(([[, , left], [, , less]]) => less < left), "it counts down");
  for (const [[at, clears, left], [after, , less]] of steps) {
    assert.ok(near(clears, at + 1000 * left, 1100), `${left} s from ${at} is not ${clears}`);
    assert.ok(near(left - less, (after - at) / 1000, 1.1), `${left} to ${less} in ${after - at} ms`);
  }
});

test("a parameter that is missing leaves the others, and the bar at the foot of the chart ends as the verdict stands", TEST, async () => {
  await open(`${HERE}/weather`);
  const names = () => page.locator('[data-testid="station"] tbody tr').evaluateAll((all) => all.map((one) => [one.children[0].textContent, one.children[1].textContent]));
  await becomes(names, (all) => all.length === 12, "all parameters");
  await fields(WEATHER, { humidity_percent: { no_data: "not implemented" }, sky_lux: { no_data: "timeout" } });
  const left = await becomes(names, (all) => all.length === 10, "those that are left");
  assert.ok(left.every(([name, value]) => !/^(Humidity|Sky brightness)$/.test(name) && /\d/.test(value)), String(left));
  await becomes(async () => (await panels()).map(({ name }) => name).filter((name) => /Wind|Humidity/.test(name)), ["Wind"], "their past");
  /** How far the last time that was not safe ends before now, px. */
  const before = async () => { const wind = await panel("Wind"); return wind && wind.right - Math.max(...wind.told.filter(({ rect }) => rect && near(rect[3], wind.bottom - wind.top, 1)).map(({ rect: [x, , width] }) => x + width)); };
  await becomes(before, (px) => px > 20, "safe: the last bar has ended");
  const [first, last] = recorded[SAFETY].intervals;
  await bus.put({ [SAFETY]: { ...recorded[SAFETY], verdict: "unsafe", reasons: [{ input: "weather/WindSpeed", why: "17.3 m/s is above 15 m/s", clears_in_s: 1260 }], intervals: [first, { ...last, until_utc: "2026-11-27T02:00:00Z" }, { verdict: "unsafe", from_utc: "2026-11-27T02:00:00Z", reasons: [] }] } });
  await becomes(before, (px) => near(px, 0, 3), "unsafe: it goes on until now");
});

test("three days of twelve parameters are below 300 kB, and a gust of seconds is seen in them", TEST, async () => {
  let size = 0;
  await page.route(/\/series\?/, (route) => {
    const asked = new URL(route.request().url()).searchParams;
    const [count, from] = [Number(asked.get("points")), Date.parse(asked.get("from_utc"))];
    const points = (isGust) => Array.from({ length: count }, (_, i) => ({ at_utc: `${new Date(from + (i * 72 * 3600e3) / count).toISOString().slice(0, -1)}000Z`, count: 300, min: 1 + Math.sin(i) / 3, mean: 2 + Math.sin(i) / 3, max: isGust && i === 100 ? 31.5 : 3 + Math.sin(i) / 3 }));
    const rows = asked.get("properties").split(",").map((one) => { const [kind, name, property] = one.split("/"); return { series: { kind, device: name, property, piece_s: 1080, points: points(property === "WindGust"), gaps: [] } }; });
    const body = JSON.stringify({ rows, truncated: false });
    if (rows.length === 12 && asked.get("from_utc") < "2026-11-25") size = body.length;
    return route.fulfill({ contentType: "application/json", body });
  });
  await open(`${HERE}/weather`);
  await becomes(() => page.locator('[data-testid="station"] tbody tr').count(), 12, "all parameters");
  await page.getByRole("button", { name: "3 d", exact: true }).first().click();
  await page.locator('[data-testid="station"] tr', { hasText: /Gusts.*… 31\.5/ }).waitFor();
  await becomes(() => page.locator('[data-testid="chart"]').first().getAttribute("aria-label"), (words) => /Gusts [\d.]+ m\/s, from [\d.]+ m\/s to 31\.5 m\/s/.test(words), "the chart has it");
  assert.ok(size > 100_000 && size < 300_000, `${size} bytes`);
  await page.unroute(/\/series\?/);
});

test("the figures of guiding leave outliers out, with them beside, in px and in arcsec; both axes have one scale and forms of their own", TEST, async () => {
  const made = Array.from({ length: 30 }, (_, i) => ({ east: i === 10 ? 4.2 : ((i % 7) - 3) / 2, north: i === 20 ? -3.6 : ((i % 5) - 2) / 3 + 0.1, out: { 10: "east", 20: "north" }[i] }));
  const axis = (one, name) => ({ error_px: one[name], why: one.out === name ? "outlier" : "corrected", pulse_ms: 0, given_ms: Math.round(-100 * one[name]) });
  await page.route(/\/guiding\/corrections\?/, (route) => {
    const from = Date.parse(new URL(route.request().url()).searchParams.get("from_utc"));
    return route.fulfill({ json: { rows: made.map((one, i) => ({ correction: { frame: `f${i}`, camera: "camera", mid_utc: new Date(from + (10 + 3 * i) * 60e3).toISOString(), pier_side: i < 15 ? "east" : "west", stars: 20, fwhm_px: 2.5, east: axis(one, "east"), north: axis(one, "north") } })), truncated: false } });
  });
  await open(`${HERE}/guiding`);
  const card = page.getByRole("region", { name: "Where the star went" });
  const rms = (name, isAll) => { const all = made.filter((one) => isAll || one.out !== name).map((one) => one[name]); return Math.sqrt(all.reduce((sum, one) => sum + one * one, 0) / all.length); };
  const stat = (name) => text(card.locator("dl", { hasText: name }));
  const scale = 2.639407;
  for (const [unit, k] of /** @type {const} */ ([["px", 1], ["″", scale]])) {
    await page.getByRole("group", { name: "Unit of errors" }).getByRole("button", { name: unit }).click();
    for (const name of ["east", "north"]) {
      const [own, all] = await becomes(async () => (await stat(`RMS ${name}`)).match(new RegExp(`RMS ${name} ([\\d.]+) ${unit} with outliers ([\\d.]+) ${unit}`))?.slice(1).map(Number), Boolean, `${name} in ${unit}`);
      assert.ok(near(own, k * rms(name, false), 0.01 * k * rms(name, false)) && near(all, k * rms(name, true), 0.01 * k * rms(name, true)), `${name}: ${own} ${all} ${unit}`);
    }
    await becomes(() => text(page.locator('[data-testid="chart"] .panel').first()), (told) => told.includes(unit), "the panel's unit");
    await card.locator("svg text", { hasText: `east, ${unit}` }).waitFor();
  }
  await becomes(() => card.locator(".ln.cross").count(), 2, "outliers are still drawn");
  const drawn = await card.locator("circle.pt").evaluateAll((all) => all.map((one) => [Number(one.getAttribute("cx")), Number(one.getAttribute("cy"))]));
  const own = made.filter(({ out }) => !out);
  assert.equal(drawn.length, own.length);
  const [a, b] = [0, 6].map((i) => ({ ...own[i], x: drawn[i][0], y: drawn[i][1] }));
  const [across, up] = [(b.x - a.x) / (b.east - a.east), (a.y - b.y) / (b.north - a.north)];
  assert.ok(near(8 * across, 8 * up, 1), `${across} and ${up} px for one unit`);
  const forms = await page.locator('[data-testid="chart"] .panel').evaluateAll((all) => all.slice(0, 2).map((one) => [...one.querySelectorAll(".read .key")].map(({ className, textContent }) => `${className.replace(/^m key ?/, "")} ${textContent}`)));
  assert.deepEqual(forms, [["dot east", "ring north"], [" east", "dash north"]]);
  const well = await page.evaluate(() => getComputedStyle(document.documentElement).getPropertyValue("--well").trim());
  assert.ok((await panel("Error")).told.some(({ filled }) => filled === well), "the dots of the second are hollow");
  assert.ok((await panel("Pulse")).told.some(({ dash }) => String(dash) === "6,3"), "and its line is broken");
  await bus.put({ [GUIDING]: { ...recorded[GUIDING], active: false, detail: "" } });
  await page.locator('[data-testid="guiding-now"]', { hasText: "Not guiding now. WASP-18 ended at 02:23:34." }).waitFor();
  await becomes(() => card.locator("circle.pt").count(), own.length, "what was guided on stays");
  await page.unroute(/\/guiding\/corrections\?/);
});

const places = Array.from({ length: 10 }, (_, i) => 22_700 + 100 * i);
const sized = (position) => Math.hypot(1.9, 0.0161 * (position - 23_150.4));
const point = (position, value) => ({ position, pass: "coarse", ...(value === null ? { reason: "no star can be sized" } : { value, error: 0.3, stars: 30 }), frames: [] });
const runs = (change) => bus.put({ [FOCUS]: { ...recorded[FOCUS], run: { ...RUN, points: places.map((one) => point(one, sized(one))), ...change } } });
const vcurve = page.getByRole("img", { name: "Size of stars against the focuser's position" });

test("a focus run is drawn where its numbers are: points, errors, best position and its zone; its curve has a name", TEST, async () => {
  await runs({});
  await open(`${HERE}/focus`);
  await becomes(() => vcurve.locator("circle.pt").count(), places.length);
  const drawn = await vcurve.evaluate((svg) => {
    const of = (one, ...names) => names.map((name) => Number(one.getAttribute(name)));
    const numbers = (one) => one.getAttribute("d").match(/-?[\d.]+/g).map(Number);
    const groups = [...svg.querySelectorAll("g")].filter((one) => one.querySelector("circle.pt"));
    return { points: groups.map((one) => of(one.querySelector("circle.pt"), "cx", "cy")), errors: groups.map((one) => numbers(one.querySelector("path"))), mark: numbers(svg.querySelector(".mark"))[0], zone: of(svg.querySelector(".limzone"), "x", "width"), line: numbers([...svg.children].find((one) => one.matches("path.ln"))) };
  });
  const [p, q] = [drawn.points[0], drawn.points[9]];
  const X = (position) => p[0] + ((position - places[0]) / 900) * (q[0] - p[0]);
  const up = (drawn.points[4][1] - p[1]) / (sized(places[0]) - sized(places[4]));
  for (const [i, position] of places.entries()) {
    const [x, y] = drawn.points[i];
    assert.ok(near(x, X(position), 0.5) && near(y, p[1] + up * (sized(places[0]) - sized(position)), 0.5), `${position}: ${x} ${y}`);
    const [ex, ey0, ey1] = drawn.errors[i];
    assert.ok(near(ex, x, 0.5) && near(Math.abs(ey1 - ey0), 0.6 * up, 0.5), `error of ${position}: ${drawn.errors[i]}`);
  }
  assert.ok(near(drawn.mark, X(23_150.4), 0.5) && near(drawn.zone[0], X(23_150.4 - 118), 0.5) && near(drawn.zone[1], X(236) - X(0), 0.5), `${drawn.mark} ${drawn.zone}`);
  const lowest = drawn.line.reduce((best, y, i, all) => (i % 2 && y > best[1] ? [all[i - 1], y] : best), [0, 0]);
  assert.ok(near(lowest[0], X(23_150.4), (q[0] - p[0]) / 60), `the curve is lowest at ${lowest[0]}`);
  const keys = page.locator(".card", { has: vcurve }).locator("header");
  await keys.filter({ hasText: "hyperbola" }).waitFor();
  await runs({ operator: "tenengrad", curve: { model: "local_regression", best_position: 23_150, best_value: 2, larger_is_better: true, places: places.map((one) => [one, 5]) } });
  await keys.filter({ hasText: "local regression" }).waitFor();
  await becomes(() => vcurve.locator(":scope > path.ln").count(), 1, "its curve is drawn, too");
  await runs({ curve: undefined, outcome: "failed", best_position: undefined, reason: "the curve has no minimum within the range: look for clouds" });
  await keys.filter({ hasText: "no curve" }).waitFor();
  await page.locator('[data-testid="run-failed"]', { hasText: "No focus. the curve has no minimum within the range: look for clouds" }).waitFor();
  const alert = { id: "focus-failed/camera", priority: "medium", cause: "The focus run of camera found no curve.", consequence: "Stars may be larger than they need to be.", action: "Look at the points of the run.", raised_utc: "2026-11-27T02:21:10Z" };
  await bus.put({ [key("observatory/alerts")]: { alerts: [alert] } });
  await open(HERE);
  await page.locator(`[data-testid="now"] [data-alert="${alert.id}"]`, { hasText: alert.cause }).waitFor();
});

test("points of a focus run come as they are measured, one that failed as a cross; positions by temperature need three runs", TEST, async () => {
  const learned = (count) => bus.put({ [key("observatory/focus-learned")]: { focusers: { focuser: Array.from({ length: count }, (_, i) => ({ id: `run${i}`, at_utc: `2026-11-2${i}T02:00:00Z`, filter: "R", wheel_offset: -20, position: 24_980 - 14 * i, temperature_c: 10 + i })) } }, [FOCUS]: { ...recorded[FOCUS], focusers: [{ focuser: "focuser", best_position: 25_000, temperature_c: 10.4, runs: count, steps_per_c: -14, steps_per_c_error: 0.8 }] } });
  await learned(2);
  await open(`${HERE}/focus`);
  for (let n = 1; n <= 6; n += 1) {
    await runs({ outcome: "running", curve: undefined, best_position: undefined, critical_zone: undefined, points: places.slice(0, n).map((one, i) => point(one, i === 2 ? null : sized(one))) });
    await becomes(async () => [await vcurve.locator("circle.pt").count(), await vcurve.locator(".cross").count()], [n < 3 ? n : n - 1, n < 3 ? 0 : 1], `${n} points`);
  }
  const card = page.locator('[data-testid="temperature"]');
  await learned(2);
  await page.getByText("2 runs, −14.0 steps/°C").waitFor();
  assert.equal(await card.count(), 0);
  await learned(3);
  await card.filter({ hasText: "3 runs of focuser, −14.0 ± 0.8 steps/°C" }).waitFor();
  await becomes(() => card.locator("circle.pt").count(), 3);
  await page.unrouteAll({ behavior: "ignoreErrors" });
});
