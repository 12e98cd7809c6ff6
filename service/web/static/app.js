// What every page shares: the list of keys, and one place that knows when keys are for typing.

document.documentElement.classList.add("has-script");

/** True while keys belong to a field, a dialog or the browser. */
export function isTyping(/** @type {KeyboardEvent} */ event) {
  const at = /** @type {HTMLElement} */ (event.target);
  return (
    event.ctrlKey || event.metaKey || event.altKey ||
    (at instanceof HTMLElement && at.matches("input, select, textarea, [contenteditable]")) ||
    document.querySelector("dialog[open]") !== null
  );
}

const help = /** @type {HTMLDialogElement | null} */ (document.querySelector("#help"));
document.querySelector("#help-button")?.addEventListener("click", () => help?.showModal());
document.addEventListener("keydown", (event) => {
  if (event.key === "?" && !isTyping(event)) {
    event.preventDefault();
    help?.showModal();
  }
});

// An open menu closes with Escape, and with a click elsewhere.
document.addEventListener("keydown", (event) => {
  const menu = document.querySelector("details.menu[open]");
  if (event.key !== "Escape" || !menu) return;
  menu.removeAttribute("open");
  menu.querySelector("summary")?.focus();
});
document.addEventListener("click", (event) => {
  const menu = document.querySelector("details.menu[open]");
  if (menu && event.target instanceof Node && !menu.contains(event.target)) menu.removeAttribute("open");
});
