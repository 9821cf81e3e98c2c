// Time for ages: it also passes while the machine sleeps, which the browser's own monotonic clock lacks on phones, Macs and Linux.

/** The wall clock that goes so much further than the browser's own between two looks, ms: the machine slept. */
const SLEEP_MS = 2000;
let slept = 0;
let [wall, own] = [Date.now(), performance.now()];

/** Monotonic ms, those of sleep included. A wall clock that is set back counts as nothing. */
export function elapsed() {
  const [wallNow, ownNow] = [Date.now(), performance.now()];
  const jump = wallNow - wall - (ownNow - own);
  if (jump > SLEEP_MS && ownNow >= own) slept += jump;
  [wall, own] = [wallNow, ownNow];
  return ownNow + slept;
}

/** How long the machine has slept since the page was loaded, ms. */
export function sleptMs() {
  elapsed();
  return slept;
}
