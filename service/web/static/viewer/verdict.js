// @ts-check
/** Verdict by keyboard: a digit for the verdict, a digit for the cause, Enter saves and goes on. */

/** Return a name that no other write has; `randomUUID` is missing over plain HTTP. */
export function newKey() {
  const bytes = crypto.getRandomValues(new Uint8Array(18));
  return btoa(String.fromCharCode(...bytes)).replaceAll("+", "-").replaceAll("/", "_");
}

/** Return the fields of a JSON answer; null for any other text. @param {string} text */
function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

/**
 * Send a form and return the answer.
 * @param {string} path
 * @param {Record<string, string>} fields
 */
export async function post(path, fields) {
  const answer = await fetch(path, {
    method: "POST",
    headers: { accept: "application/json" },
    body: new URLSearchParams(fields),
  });
  const text = await answer.text();
  const facts = parsed(text);
  if (!answer.ok || !facts) {
    const sentence = facts?.problem ?? (text.length < 200 ? text.trim() : "");
    throw new Error(sentence || `the page answered ${answer.status}`);
  }
  return facts;
}

const TOLD = "counterpoint-told"; // a sentence for the page that is loaded next

export class Judge {
  /**
   * @param {HTMLFormElement} form
   * @param {{unjudged: string, list: string}} order
   * @param {() => number | null} selected The selected track.
   */
  constructor(form, order, selected) {
    this.form = form;
    this.order = order;
    this.selected = selected;
    this.status = /** @type {HTMLElement} */ (form.querySelector("#status"));
    this.target = /** @type {HTMLSelectElement} */ (form.elements.namedItem("track_id"));
    this.note = /** @type {HTMLInputElement} */ (form.elements.namedItem("note"));
    this.verdicts = this.#radios("verdict");
    this.causes = this.#radios("cause");
    this.key = newKey();
    this.undoKey = newKey(); // kept until it is answered: what is sent again is undone once
    this.saving = false;
    this.since = performance.now();
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.save();
    });
    form.addEventListener("change", () => this.tell(""));
    const told = sessionStorage.getItem(TOLD);
    if (told) this.tell(told);
    sessionStorage.removeItem(TOLD);
  }

  /** @param {string} name @returns {HTMLInputElement[]} */
  #radios(name) {
    return [...this.form.querySelectorAll(`input[name="${name}"]`)].map(
      (each) => /** @type {HTMLInputElement} */ (each),
    );
  }

  /** Show a sentence under the form. @param {string} words @param {boolean} [bad] */
  tell(words, bad = false) {
    this.status.textContent = words;
    this.status.classList.toggle("bad", bad);
  }

  /** True once a verdict is chosen and digits mean its cause. */
  get chosen() {
    return this.verdicts.some((each) => each.checked);
  }

  /**
   * Take a digit: the verdict, or then the cause; 0 changes between scene and track.
   * @param {number} digit
   */
  digit(digit) {
    if (digit === 0) {
      const track = this.selected();
      this.target.value = this.target.value === "" && track !== null ? String(track) : "";
      this.tell(`verdict on ${this.target.selectedOptions[0].text}`);
      return;
    }
    const choice = (this.chosen ? this.causes : this.verdicts)[digit - 1];
    if (!choice) return;
    choice.checked = choice.name === "verdict" || !choice.checked;
    this.tell(`${choice.parentElement?.textContent?.trim().replace(/^\d+\s*/, "")} chosen`);
  }

  /** Choose the next of the causes that no digit reaches: those of the user's own list. */
  ownCause() {
    const own = this.causes.slice(9);
    if (!own.length) return;
    const choice = own[(own.findIndex((each) => each.checked) + 1) % own.length];
    choice.checked = true;
    this.tell(`${choice.value} chosen`);
  }

  /** Clear what is chosen; false where nothing was. */
  clear() {
    const was = this.chosen;
    for (const each of [...this.verdicts, ...this.causes]) each.checked = false;
    if (was) this.tell("verdict cleared");
    return was;
  }

  /** Store the verdict. After one on the scene go to the next that this reviewer has not judged. */
  async save() {
    if (this.saving) return;
    if (!this.chosen) {
      this.tell("choose a verdict first: keys 1 to 6", true);
      return;
    }
    if (!this.form.reportValidity()) return;
    this.saving = true;
    this.tell("saving");
    const fields = /** @type {Record<string, string>} */ (
      Object.fromEntries([...new FormData(this.form)].map(([name, value]) => [name, String(value)]))
    );
    if (fields.verdict !== "duplicate") delete fields.duplicate_of;
    fields.key = this.key;
    fields.took_s = ((performance.now() - this.since) / 1000).toFixed(1);
    try {
      const { stored, progress } = await post("/verdict", fields);
      this.key = newKey();
      const shown = document.querySelector("#progress");
      if (shown && progress?.text) shown.textContent = progress.text;
      if (stored.record === "replaced") {
        this.tell("saved for the record that you saw; the scene was mined again: load it again");
      } else if (fields.track_id) {
        sessionStorage.setItem(TOLD, `saved for track ${Number(fields.track_id) + 1}; J: next scene`);
        location.reload();
      } else if (this.order.unjudged) location.assign(this.order.unjudged);
      else this.tell("saved; every scene of the list is judged");
    } catch (error) {
      const words = error instanceof Error ? error.message : String(error);
      this.tell(`not saved: ${words}. Enter tries again.`, true);
    }
    this.saving = false;
  }

  /** Undo the reviewer's last verdict, and show its scene. */
  async undo() {
    this.tell("undoing");
    const token = String(new FormData(this.form).get("token"));
    try {
      const { stored } = await post("/undo", { token, key: this.undoKey });
      this.undoKey = newKey();
      sessionStorage.setItem(TOLD, "your last verdict, on this scene, is undone");
      const here = new URL(location.href);
      here.searchParams.delete("frame");
      here.searchParams.delete("track");
      here.searchParams.set("id", stored.scene_id);
      location.assign(here);
    } catch (error) {
      this.tell(`not undone: ${error instanceof Error ? error.message : error}`, true);
    }
  }
}
