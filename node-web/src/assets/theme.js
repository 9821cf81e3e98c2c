// Applies the chosen theme before the first paint, so that a dark room stays dark.
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
