// Where a telescope stands, for twilight, altitudes and the sky map.

/** `{ lat, lon }` of a telescope in degrees by its summary, or null while it is not known. */
export const siteOf = (summary) => (summary?.place ? { lat: summary.place.latitude_deg, lon: summary.place.longitude_deg } : null);
