// @ts-check
// The exports of a selection: progress of those that run, once a second.

const place = /** @type {HTMLElement} */ (document.querySelector("#exports"));
const EVERY_MS = 1000;

/** Lines whose export runs or waits. */
const open = () => [...place.querySelectorAll('[data-state="running"], [data-state="waiting"]')];

async function look() {
  const name = encodeURIComponent(place.dataset.selection ?? "");
  const answer = await fetch(`/data/exports?selection=${name}`).catch(() => null);
  if (answer?.ok) for (const job of (await answer.json()).jobs) show(job);
  if (open().length) setTimeout(look, EVERY_MS);
}

/** @param {{number: number, state: string, done: number, scenes: number, text: string, is_open: boolean}} job */
function show(job) {
  const line = /** @type {HTMLElement | null} */ (place.querySelector(`[data-job="${job.number}"]`));
  if (!line) return;
  const put = (/** @type {string} */ part, /** @type {string} */ text) => {
    const at = line.querySelector(part);
    if (at && at.textContent !== text) at.textContent = text;
  };
  line.dataset.state = job.state;
  put(".state", job.state);
  put(".count", `${job.done} of ${job.scenes} scene${job.scenes === 1 ? "" : "s"}`);
  put(".told", job.text);
  const bar = line.querySelector("progress");
  if (bar) bar.value = job.done;
  if (!job.is_open) line.querySelector("form")?.remove();
}

if (open().length) setTimeout(look, EVERY_MS / 3);
