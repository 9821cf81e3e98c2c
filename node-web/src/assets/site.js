// Where a telescope stands, for twilight, altitudes and the sky map; and which night it has there.
import { nightOf } from "./format.js";
import { skyNow } from "./store.js";

/** `{ lat, lon }` of a telescope in degrees by its summary, or null while it is not known. */
export const siteOf = (summary) => (summary?.place ? { lat: summary.place.latitude_deg, lon: summary.place.longitude_deg } : null);

/** The name of the night of now, `20261120`, as the archive of a telescope has it; by UTC where its place is not known, and null before the first message. */
export const tonight = (summary) => summary?.night ?? (skyNow() === null ? null : nightOf(skyNow()));

/** The nights of now of several telescopes, each once. */
export const nightsOf = (summaries) => [...new Set(summaries.map(tonight))].filter(Boolean).sort();
