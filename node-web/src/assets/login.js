// Logs in by the API, and then loads the page that was asked for.
const form = /** @type {any} */ (document.getElementById("login"));
const answer = document.getElementById("answer");

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const button = form.querySelector("button");
  button.disabled = true;
  answer.textContent = "…";
  try {
    const response = await fetch("/api/v1/login", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ name: form.elements.name.value, password: form.elements.password.value }),
    });
    if (response.ok) {
      location.reload();
      return;
    }
    const problem = await response.json().catch(() => ({}));
    answer.textContent = `▲ ${problem.detail ?? `The server answered ${response.status}.`}`;
    form.elements.password.select();
  } catch {
    answer.textContent = "▲ The server does not answer.";
  }
  button.disabled = false;
});
