// How the page looks in this browser: theme and density, applied before the first paint by theme.js and changed here.
import { signal } from "./lib.js";

const root = document.documentElement;
export const theme = signal(root.dataset.theme);
export const density = signal(root.dataset.density);

/** Chooses a `theme` or a `density`, and keeps it in this browser. */
export function choose(name, value) {
  root.dataset[name] = value;
  ({ theme, density })[name].value = value;
  try { localStorage.setItem(name, value); } catch { /* private window */ }
}
