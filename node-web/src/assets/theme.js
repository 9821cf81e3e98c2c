// Applies the chosen theme before the first paint, so that a dark room stays dark; and watches whether the page still draws.
(() => {
  const root = document.documentElement;
  const asked = new URLSearchParams(location.search);
  const stored = (name) => { try { return localStorage.getItem(name); } catch { return null; /* private window */ } };
  const choose = (name, known) => {
    const value = asked.get(name) ?? stored(name);
    if (known.includes(value)) root.dataset[name] = value;
  };
  choose("theme", ["dark", "light", "night"]);
  choose("density", ["compact", "roomy"]);
})();

// The page draws itself at least once a second. When it no longer does, whatever it showed is old: it is hidden, and a red
// bar says so. This needs nothing of the scripts that may have failed, or that have never come.
(() => {
  const LONGEST_MS = 5000;
  let seen = performance.now();
  // A hidden tab is not drawn, and the time for which it was hidden does not count.
  document.addEventListener("visibilitychange", () => { seen = performance.now(); });
  setInterval(() => {
    if (!document.body || document.visibilityState !== "visible") return;
    const drawn = document.body.dataset.drawn === undefined ? 0 : Number(document.body.dataset.drawn);
    const now = performance.now();
    const broken = drawn === -Infinity || (now - drawn > LONGEST_MS && now - seen > LONGEST_MS);
    document.body.toggleAttribute("data-broken", broken);
    const bar = document.getElementById("broken");
    if (bar) bar.hidden = !broken;
    if (broken && !document.title.startsWith("BROKEN")) document.title = "BROKEN – Starmesh";
  }, 1000);
})();
