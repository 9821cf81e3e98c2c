// A frame's numbers in tiles of 16 bits, and how they become a picture: black, white and a curve, chosen in the browser.

/** Tiles of one frame; each is read once. Level 0 is the whole frame in one tile, at level `highest` a number is one pixel. */
export class Tiles {
  constructor(id, frame) {
    this.address = `/api/v1/telescopes/${id}/frames/${encodeURIComponent(frame)}/tiles`;
    this.known = new Map();
    this.highest = null;
    this.zero = 0;
    this.scale = 1;
    this.blank = null;
  }

  /** The numbers of a tile: `{ width, height, values }`, or null where there is none. */
  get(z, x, y) {
    const key = `${z}/${x}/${y}`;
    // What was not got is asked for again by whoever asks next.
    if (!this.known.has(key)) this.known.set(key, this.read(key).catch((error) => { this.known.delete(key); throw error; }));
    return this.known.get(key);
  }

  async read(key) {
    const response = await fetch(`${this.address}/${key}`).catch(() => { throw new Error("The server does not answer."); });
    if (response.status === 404) return null;
    if (!response.ok) {
      const problem = await response.json().catch(() => null);
      throw new Error(problem?.detail ?? `The server answered ${response.status}.`);
    }
    const number = (name) => { const text = response.headers.get(name); return text === null ? null : Number(text); };
    this.highest = number("tile-highest-z") ?? 0;
    this.zero = number("tile-zero") ?? 0;
    this.scale = number("tile-scale") ?? 1;
    this.blank = number("tile-blank");
    const [width, height] = [number("tile-width"), number("tile-height")];
    const buffer = await response.arrayBuffer();
    const view = new DataView(buffer);
    const values = new Uint16Array(width * height);
    for (let i = 0; i < values.length; i += 1) values[i] = view.getUint16(2 * i, true);
    return { width, height, values };
  }

  /** The value in counts of a number of a tile; NaN where the pixel has none. */
  counts(number) {
    return number === this.blank ? NaN : this.zero + this.scale * number;
  }
}

/** Numbers in order, those without a value left out. */
const ordered = (tile, blank) => Uint16Array.from(blank === null ? tile.values : tile.values.filter((value) => value !== blank)).sort();
const quantile = (sorted, part) => sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))] ?? 0;

/** Black and white, in numbers of tiles, that show the sky as dark grey and faint stars bright. */
export function automatic(tile, blank) {
  const sorted = ordered(tile, blank);
  const middle = quantile(sorted, 0.5);
  const noise = Math.max(1, (quantile(sorted, 0.5) - quantile(sorted, 0.16)));
  return { black: Math.max(0, middle - 2.5 * noise), white: Math.max(middle + 25 * noise, quantile(sorted, 0.998)) };
}

/** How many numbers fall in each of `bins` between two. */
export function histogram(tile, low, high, bins) {
  const counts = new Float64Array(bins);
  for (const value of tile.values) {
    const bin = Math.floor(((value - low) / (high - low)) * bins);
    if (bin >= 0 && bin < bins) counts[bin] += 1;
  }
  return counts;
}

export const CURVES = {
  asinh: (part) => Math.asinh(part * 10) / Math.asinh(10),
  sqrt: Math.sqrt,
  log: (part) => Math.log1p(part * 1000) / Math.log1p(1000),
  linear: (part) => part,
};

/** Grey of each of the 65,536 numbers. */
export function greys({ black, white, curve, invert }) {
  const table = new Uint8ClampedArray(65536);
  const bend = CURVES[curve] ?? CURVES.asinh;
  for (let value = 0; value < table.length; value += 1) {
    const grey = 255 * bend(Math.min(1, Math.max(0, (value - black) / Math.max(1e-9, white - black))));
    table[value] = invert ? 255 - grey : grey;
  }
  return table;
}

/** A tile as a picture of its own. */
export function drawn(tile, table, blank) {
  const canvas = document.createElement("canvas");
  canvas.width = tile.width;
  canvas.height = tile.height;
  const picture = new ImageData(tile.width, tile.height);
  for (let i = 0; i < tile.values.length; i += 1) {
    const number = tile.values[i];
    const grey = number === blank ? 0 : table[number];
    picture.data[4 * i] = grey;
    picture.data[4 * i + 1] = grey;
    picture.data[4 * i + 2] = grey;
    picture.data[4 * i + 3] = 255;
  }
  canvas.getContext("2d").putImageData(picture, 0, 0);
  return canvas;
}

const rad = Math.PI / 180;

/** Right ascension and declination in degrees of a pixel (0, 0 is the first), by the frame's linear solution (TAN). */
export function skyOf(wcs, x, y) {
  if (!wcs?.cd_deg_px) return null;
  const [[a, b], [c, d]] = wcs.cd_deg_px;
  const [dx, dy] = [x - wcs.x_px, y - wcs.y_px];
  const [xi, eta] = [(a * dx + b * dy) * rad, (c * dx + d * dy) * rad];
  const [ra0, dec0] = [wcs.ra_deg * rad, wcs.dec_deg * rad];
  const below = Math.cos(dec0) - eta * Math.sin(dec0);
  const ra = ra0 + Math.atan2(xi, below);
  const dec = Math.atan2(Math.sin(dec0) + eta * Math.cos(dec0), Math.hypot(xi, below));
  return [(((ra / rad) % 360) + 360) % 360, dec / rad];
}

/** The pixel of a place in the sky, or null behind the tangent plane. */
export function pixelOf(wcs, raDeg, decDeg) {
  if (!wcs?.cd_deg_px) return null;
  const [ra, dec, ra0, dec0] = [raDeg * rad, decDeg * rad, wcs.ra_deg * rad, wcs.dec_deg * rad];
  const below = Math.sin(dec) * Math.sin(dec0) + Math.cos(dec) * Math.cos(dec0) * Math.cos(ra - ra0);
  if (below <= 0.01) return null;
  const xi = (Math.cos(dec) * Math.sin(ra - ra0)) / below / rad;
  const eta = (Math.sin(dec) * Math.cos(dec0) - Math.cos(dec) * Math.sin(dec0) * Math.cos(ra - ra0)) / below / rad;
  const [[a, b], [c, d]] = wcs.cd_deg_px;
  const det = a * d - b * c;
  return [wcs.x_px + (d * xi - b * eta) / det, wcs.y_px + (a * eta - c * xi) / det];
}
