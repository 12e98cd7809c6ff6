// The ranking: keys, filters that apply at once, and the line about new scenes.

import { isTyping } from "./app.js";

const form = /** @type {HTMLFormElement} */ (document.querySelector("#filters"));
const search = /** @type {HTMLInputElement} */ (document.querySelector("#search"));
const links = /** @type {HTMLAnchorElement[]} */ ([...document.querySelectorAll("a.headline")]);

/** Leave empty fields out of the address, so that links stay short. */
form.addEventListener("submit", () => {
  for (const field of form.querySelectorAll("input, select")) {
    if (field instanceof HTMLInputElement || field instanceof HTMLSelectElement) {
      if (field.name && !field.value) field.disabled = true;
    }
  }
});
form.addEventListener("change", (event) => {
  if (event.target instanceof HTMLSelectElement) form.requestSubmit();
});
window.addEventListener("pageshow", () => {
  for (const field of form.querySelectorAll(":disabled")) field.removeAttribute("disabled");
});

function move(/** @type {number} */ by) {
  const at = links.indexOf(/** @type {HTMLAnchorElement} */ (document.activeElement));
  const to = links[at < 0 ? (by > 0 ? 0 : links.length - 1) : Math.min(links.length - 1, Math.max(0, at + by))];
  if (!to) return;
  to.focus({ preventScroll: true });
  to.closest(".scene")?.scrollIntoView({ block: "nearest" });
}

function go(/** @type {string} */ selector) {
  const link = /** @type {HTMLAnchorElement | null} */ (document.querySelector(selector));
  link?.click();
}

document.addEventListener("keydown", (event) => {
  if (event.target === search && event.key === "Escape") search.blur();
  if (isTyping(event)) return;
  const key = event.key.toLowerCase();
  if (key === "j") move(1);
  else if (key === "k") move(-1);
  else if (key === "/") search.focus();
  else if (key === "f") toggleFilters();
  else if (key === "n") go('.pages [rel="next"]');
  else if (key === "p") go(".pages a:not([rel])");
  else if (key === "r") location.reload();
  else return;
  event.preventDefault();
});

function toggleFilters() {
  const box = /** @type {HTMLInputElement} */ (document.querySelector("#open-filters"));
  box.checked = true;
  /** @type {HTMLElement | null} */ (document.querySelector(".filters select"))?.focus();
}

// The card that was opened last has the focus when one comes back.
const opened = sessionStorage.getItem("opened");
for (const link of links) {
  link.addEventListener("click", () => sessionStorage.setItem("opened", link.pathname + link.search));
  if (opened === link.pathname + link.search) link.focus({ preventScroll: true });
}

// New scenes: the server counts those that pass the filters of this page.
const live = /** @type {HTMLElement} */ (document.querySelector("#live"));
const query = new URLSearchParams(location.search);
query.delete("after");
query.set("since_seq", live.dataset.since ?? "0");
/** @type {EventSource | null} */
let events = null;

/** Listen while the tab is looked at: a browser has six connections to a host for all its tabs. */
function listen() {
  if (document.hidden) {
    events?.close();
    events = null;
  } else if (events === null) {
    events = new EventSource(`/live?${query}`);
    events.addEventListener("scenes", showNew);
    events.addEventListener("progress", showProgress);
  }
}

function showNew(/** @type {MessageEvent} */ event) {
  const { count } = JSON.parse(event.data);
  const link = /** @type {HTMLAnchorElement} */ (live.querySelector("a"));
  link.textContent = `${count} new ${count === 1 ? "scene" : "scenes"}: show`;
  live.hidden = count === 0;
}

function showProgress(/** @type {MessageEvent} */ event) {
  const line = document.querySelector("#progress");
  if (line) line.textContent = JSON.parse(event.data).text;
}

document.addEventListener("visibilitychange", listen);
window.addEventListener("pagehide", () => {
  events?.close();
  events = null;
});
window.addEventListener("pageshow", listen);

document.documentElement.dataset.keys = "ready";
