// The inputs of the verdict: their names for people, units and limits.
import { html } from "./lib.js";
import { number, plain } from "./format.js";

/**
 * Property of ObservingConditions, field of the state, name for people, unit, usual scale, decimals.
 * @type {[string, string, string, string, [number, number], number][]}
 */
export const PARAMETERS = [
  ["WindSpeed", "wind_mps", "Wind", "m/s", [0, 25], 1], ["WindGust", "gust_mps", "Gusts", "m/s", [0, 30], 1], ["Humidity", "humidity_percent", "Humidity", "%", [0, 100], 0],
  ["SkyTemperature", "sky_c", "Sky temperature", "°C", [-60, 20], 1], ["Temperature", "air_c", "Air", "°C", [-20, 40], 1], ["DewPoint", "dew_point_c", "Dew point", "°C", [-40, 30], 1],
  ["RainRate", "rain_mm_per_h", "Rain", "mm/h", [0, 10], 1], ["CloudCover", "cloud_percent", "Cloud", "%", [0, 100], 0], ["Pressure", "pressure_hpa", "Pressure", "hPa", [500, 1050], 1],
  ["SkyQuality", "sky_mag_per_arcsec2", "Sky quality", "mag/arcsec²", [0, 22], 2], ["SkyBrightness", "sky_lux", "Sky brightness", "lx", [0, 100], 3], ["StarFWHM", "star_fwhm_arcsec", "Star FWHM", "″", [0, 5], 2],
];

/** An input of the verdict in words: `weather/WindSpeed` is "wind speed", `safetymonitor/monitor` is "safety monitor". */
export function inputWords(input) {
  const [first, ...rest] = String(input).split("/");
  if (!rest.length) return first;
  const last = rest[rest.length - 1].replace(/([a-z])([A-Z])/g, "$1 $2").toLowerCase();
  return first === "safetymonitor" ? `safety monitor${last === "monitor" ? "" : ` ${last}`}` : last;
}

/** The same where a line or a cell begins, with its name on the bus as title. */
export const Input = ({ input }) => { const words = inputWords(input); return html`<span title=${input}>${words[0].toUpperCase()}${words.slice(1)}</span>`; };

/** Value of an input of the verdict, with its unit. */
export function inputValue({ input, value }) {
  const unit = PARAMETERS.find(([property]) => property === String(input).split("/").pop())?.[3];
  const text = plain(value).replace(/^-/, "\u2212").replace(/ deg$/, "°");
  return unit && /\d$/.test(text) ? `${text} ${unit}` : text;
}

/** Limits of a property, from the verdict's own state: `[{ v, side, text }]`. */
export function limitsOf(inputs, device, property) {
  const found = (inputs ?? []).filter((input) => input.input === `${device}/${property}`).flatMap((input) => input.limits ?? []);
  return found.flatMap((limit) => [
    limit.upper != null && { v: limit.upper, side: "above", text: `closes above ${number(limit.upper)}` },
    limit.lower != null && { v: limit.lower, side: "below", text: `closes below ${number(limit.lower)}` },
  ]).filter(Boolean);
}
