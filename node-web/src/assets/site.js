// Where a telescope stands, for twilight, altitudes and the sky map; by its mount, else by the server.
import { useShared } from "./api.js";

/** `{ lat, lon }` of a telescope in degrees, or null while it is not known. */
export function useSite(id, states) {
  const can = [...(states ?? [])].find(([key]) => /\/device\/telescope\/[^/]+\/capabilities$/.test(key))?.[1].body?.can;
  const own = Number.isFinite(can?.site_latitude_deg) && Number.isFinite(can?.site_longitude_deg) ? { lat: can.site_latitude_deg, lon: can.site_longitude_deg } : null;
  const asked = useShared(!own && id ? `/api/v1/telescopes/${id}/sky` : null, 3600);
  const place = asked.data?.place;
  return own ?? (place ? { lat: place.latitude_deg, lon: place.longitude_deg } : null);
}
