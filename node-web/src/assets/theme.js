// Applies the chosen theme before the first paint, so that a dark room stays dark; and watches whether the page still draws.
(() => {
  const root = document.documentElement;
  let chosen = "auto";
  try { chosen = localStorage.getItem("theme") ?? "auto"; } catch { /* private mode */ }
  root.dataset.theme = ["light", "dark", "night"].includes(chosen) ? chosen : "auto";
  addEventListener("DOMContentLoaded", () => {
    const select = document.getElementById("theme");
    select.value = root.dataset.theme;
    select.addEventListener("change", () => {
      root.dataset.theme = select.value;
      try { localStorage.setItem("theme", select.value); } catch { /* private mode */ }
    });
  });
})();

// The page draws itself at least once a second. When it no longer does, whatever it showed is old: it is hidden, and a red
// bar says so. This needs nothing of the scripts that may have failed, or that have never come.
(() => {
  const PATIENCE_MS = 5000;
  let seen = performance.now();
  // a hidden tab is not drawn, and what it was hidden for does not count
  document.addEventListener("visibilitychange", () => { seen = performance.now(); });
  setInterval(() => {
    if (!document.body || document.visibilityState !== "visible") return;
    const drawn = document.body.dataset.drawn === undefined ? 0 : Number(document.body.dataset.drawn);
    const now = performance.now();
    const failed = drawn === -Infinity;
    const broken = failed || (now - drawn > PATIENCE_MS && now - seen > PATIENCE_MS);
    document.body.toggleAttribute("data-broken", broken);
    const bar = document.getElementById("broken");
    if (bar) bar.hidden = !broken;
    if (broken && !document.title.startsWith("BROKEN")) document.title = "BROKEN – Starmesh";
  }, 1000);
})();
