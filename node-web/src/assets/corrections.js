// The past of guiding, from the archive.
import { useMemo, useSignal } from "./lib.js";
import { useGet } from "./api.js";
import { skyNow } from "./store.js";

/** The corrections of the newest hours, the oldest first. */
export function useCorrections(id, hours) {
  const now = useSignal(null);
  if (now.peek() === null && skyNow()) now.value = skyNow();
  const found = useGet(now.value && `/api/v1/telescopes/${id}/guiding/corrections?from_utc=${new Date(now.value - hours * 3600e3).toISOString()}&limit=3000`, 20);
  const corrections = (found.data?.rows ?? []).map((row) => row.correction).filter(Boolean).sort((a, b) => (a.mid_utc < b.mid_utc ? -1 : 1));
  const t1 = useMemo(() => skyNow(), [found.at]);
  return { ...found, corrections, t1 };
}
