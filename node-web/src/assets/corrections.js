// The past of guiding, from the archive.
import { useWindow } from "./history.js";

/** The corrections of the newest hours, the oldest first. */
export function useCorrections(id, hours) {
  const { found, t0, t1 } = useWindow(hours, (from) => `/api/v1/telescopes/${id}/guiding/corrections?from_utc=${from}&limit=3000`, 20);
  const corrections = (found.data?.rows ?? []).map((row) => row.correction).filter((one) => one && Date.parse(one.mid_utc) >= t0).sort((a, b) => (a.mid_utc < b.mid_utc ? -1 : 1));
  return { ...found, corrections, truncated: found.data?.truncated === true, t0, t1 };
}
