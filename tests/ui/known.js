// What a test knows beforehand: frames that an archive would list, with an upright letter F on a slope, so that no place and no turn is mistaken for another; and what a canvas shows.
const TILE = 256;
const HIGHEST = 3;

/** Is a pixel, counted from 0 from the first row, in the letter? */
const isLetter = (x, y) => x >= 400 && y >= 300 && ((x < 600 && y < 1700) || (x < 1500 && y < 500) || (x < 1100 && y >= 900 && y < 1100));
/** Its value. */
export const valueAt = (x, y) => (isLetter(x, y) ? 40_000 : 1000) + ((7 * x + 13 * y) % 500);

/** The numbers of a tile, as the archive gives them: a coarse one has one pixel of each block. */
function tile(z, tx, ty, value = valueAt) {
  const step = 2 ** (HIGHEST - z);
  const body = Buffer.alloc(2 * TILE * TILE);
  for (let y = 0; y < TILE; y += 1) for (let x = 0; x < TILE; x += 1) body.writeUInt16LE(value((tx * TILE + x) * step + (step >> 1), (ty * TILE + y) * step + (step >> 1)), 2 * (y * TILE + x));
  return { status: 200, contentType: "application/octet-stream", headers: { "tile-width": String(TILE), "tile-height": String(TILE), "tile-highest-z": String(HIGHEST), "tile-zero": "0", "tile-scale": "1" }, body };
}

/** Where a pixel looks (TAN), by unit vectors, degrees. */
export function placeOf({ ra_deg, dec_deg, x_px, y_px, cd_deg_px: [[a, b], [c, d]] }, x, y) {
  const rad = Math.PI / 180;
  const [xi, eta] = [a * (x - x_px) + b * (y - y_px), c * (x - x_px) + d * (y - y_px)].map((one) => one * rad);
  const [ra, dec] = [ra_deg * rad, dec_deg * rad];
  const middle = [Math.cos(dec) * Math.cos(ra), Math.cos(dec) * Math.sin(ra), Math.sin(dec)];
  const east = [-Math.sin(ra), Math.cos(ra), 0];
  const north = [-Math.sin(dec) * Math.cos(ra), -Math.sin(dec) * Math.sin(ra), Math.cos(dec)];
  const [px, py, pz] = middle.map((one, i) => one + xi * east[i] + eta * north[i]);
  return [(Math.atan2(py, px) / rad + 360) % 360, Math.atan2(pz, Math.hypot(px, py)) / rad];
}

/** Frames of two nights, by the order of their exposure. */
export const FRAMES = [["20261125", "WASP-18", "Light Frame"], ["20261125", "WASP-18", "Flat Frame"], ["20261125", "NGC 253", "Light Frame"], ["20261125", "WASP-18", "Light Frame"], ["20261126", "WASP-18", "Light Frame"], ["20261126", "WASP-79", "Light Frame"], ["20261126", "WASP-18", "Light Frame"]]
  .map(([night, object, image_type], i) => ({ id: `01a21800-0000-7000-8000-00000000000${i}`, at_utc: `2026-11-2${night === "20261125" ? 6 : 7}T01:0${i}:00.000000Z`, camera: "camera", file: `${night}/a "b" #${i} 100% ü?.fits`, night, object, image_type, filter: "R", exposure_s: 60, bytes: 1000 }));

/** Those that a search asks for. */
function found(url) {
  const asked = new URL(url).searchParams;
  const fits = (frame) => (!asked.get("night") || frame.night === asked.get("night")) && (!asked.get("object") || frame.object === asked.get("object")) && frame.image_type.toLowerCase().includes(asked.get("image_type") ?? "");
  return { rows: FRAMES.filter(fits).map((frame) => ({ found_frame: frame })), truncated: false };
}

/** Where the frame that has a place looks. */
export const WCS = { ra_deg: 24.35102, dec_deg: -45.68077, x_px: 1023.5, y_px: 1023.5, cd_deg_px: [[-0.0007331685, 0.0000402], [0.0000398, 0.0007331679]] };

/** Gives a page these frames, pixels and a known header; of all frames only `solved` has a place in the sky, and the fifth of the list has no letter. */
export async function known(page, solved) {
  const isPage = (route) => route.request().resourceType() === "document";
  await page.route(/\/frames\?/, (route) => (isPage(route) ? route.fallback() : route.fulfill({ json: found(route.request().url()) })));
  await page.route(/\/tiles\/\d+\/\d+\/\d+$/, (route) => {
    const [id, , z, x, y] = route.request().url().split("/").slice(-5);
    return route.fulfill(tile(Number(z), Number(x), Number(y), id === FRAMES[4].id ? () => 500 : valueAt));
  });
  const card = (keyword, value, comment = "") => ({ keyword, value, comment });
  const cards = [card("SIMPLE", true, "conforms"), card("OBJECT", "WASP-18", "name of the target"), card("HISTORY", "bias taken off"), card("COMMENT", "by hand"), card("HISTORY", "flat divided"), card("HISTORY", "bias taken off")];
  await page.route(/\/frames\/[^/]+\/header$/, (route) => route.fulfill({ json: { version: "1", hdus: [{ number: 1, cards }] } }));
  await page.route(/\/frames\/[0-9a-f-]+$/, async (route) => {
    if (isPage(route)) return route.fallback();
    const response = await route.fetch();
    const { facts, ...whole } = await response.json();
    const id = route.request().url().split("/").at(-1);
    const file = FRAMES.find((one) => one.id === id)?.file ?? whole.file;
    return route.fulfill({ json: { ...whole, id, file, facts: { ...facts, wcs: id === solved ? WCS : undefined, reason: id === solved ? undefined : "of 3 stars none fits the catalogue" } } });
  });
}

/** Runs in a page before its own scripts: each canvas has in `told` its texts, rectangles, broken lines, and the colours of what is filled, since it was cleared. */
export function noteCanvas() {
  const { prototype } = CanvasRenderingContext2D;
  const also = (name, note) => {
    const real = prototype[name];
    prototype[name] = function (...given) {
      note.call(this, /** @type {any} */ (this.canvas).told ??= [], ...given);
      return real.apply(this, given);
    };
  };
  const scale = () => devicePixelRatio;
  also("clearRect", function () { this.canvas.told = []; });
  also("fillText", (told, text, x, y) => told.push({ text, x: x / scale(), y: y / scale() }));
  also("fillRect", (told, ...rect) => told.push({ rect: rect.map((one) => one / scale()) }));
  also("moveTo", function (told, x, y) { if (this.getLineDash().length) told.push({ dashed: y / scale() }); });
  also("setLineDash", (told, dash) => dash.length && told.push({ dash: dash.map((one) => one / scale()) }));
  also("fill", function (told) { told.push({ filled: this.fillStyle }); });
}
