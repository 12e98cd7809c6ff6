// @ts-check
/** Scene page: connects the viewer, the time line, the tracks, the pictures, and the keys. */

import { isTyping } from "../app.js";
import { css, legend } from "./colours.js";
import { Frames } from "./frames.js";
import { Pictures } from "./pictures.js";
import { listen } from "./pointer.js";
import { Timeline } from "./timeline.js";
import { Judge } from "./verdict.js";
import { Viewer } from "./viewer.js";

/** @param {string} selector @returns {any} */
const one = (selector) => document.querySelector(selector);
/** @param {string} selector @returns {any[]} */
const all = (selector) => [...document.querySelectorAll(selector)];
/** @param {string} id */
const read = (id) => JSON.parse(one(`#${id}`)?.textContent || "null");

const TURN = Math.PI / 24;
const SAFE = "counterpoint-safe"; // the choice of colours outlives the page
const facts = read("facts");
const order = read("order");
const place = new URL(location.href);
/** @type {Page | null} */
let page = null;
const judge = new Judge(one("#judge"), order, () => page?.viewer.selected ?? null);

/** The page of a scene whose points can be shown. */
class Page {
  constructor() {
    this.loading = one("#loading");
    this.viewer = new Viewer([one("#left"), one("#right")], facts, (drawn) => {
      if (drawn.points) this.loading.hidden = true;
      document.documentElement.dataset.drawn = String(drawn.points ? drawn.frame : -1);
    });
    this.timeline = new Timeline(this.viewer, (frame) => this.show(frame), (track) => this.select(track));
    const url = (/** @type {string} */ kind) => (/** @type {number} */ n) =>
      `/data/${kind}?id=${encodeURIComponent(facts.id)}&digest=${facts.digest}&n=${n}`;
    this.pictures = new Pictures(one("#pictures"), this.viewer, facts.pictures, url("image"));
    this.problem = "";
    this.frames = new Frames(
      facts.frames,
      url("frame"),
      (index, frame) => {
        this.viewer.put(index, frame);
        this.timeline.draw();
        const there = this.viewer.frames.filter((each) => each).length;
        document.documentElement.dataset.loaded = String(there);
      },
      (index, problem) => this.fail(index, problem),
      (index) => this.viewer.drop(index),
    );
    this.saving = 0;
    const wanted = place.searchParams.get("track");
    const known = facts.tracks.find((/** @type {any} */ each) => String(each.id) === wanted);
    const usual = known?.frame ?? facts.start;
    const asked = Number(place.searchParams.get("frame") ?? usual);
    const frame = Number.isInteger(asked) && facts.frames[asked] ? asked : usual;
    this.frames.load(frame);
    this.viewer.show(frame);
    this.select(known?.id ?? facts.tracks[0]?.id ?? null);
    this.viewer.look();
    all("#left, #right").forEach((canvas, pane) => {
      listen(canvas, this.viewer, pane, (x, y) => this.pick(pane, x, y));
    });
    this.tools();
  }

  /** Show a frame. @param {number} frame */
  show(frame) {
    this.viewer.show(frame);
    if (!this.viewer.frames[this.viewer.frame]) this.frames.load(this.viewer.frame);
    this.timeline.draw();
    this.pictures.show();
    this.link();
  }

  /** Select a track. @param {number | null} id */
  select(id) {
    this.viewer.select(id);
    for (const each of all("details.track")) each.open = Number(each.dataset.track) === id;
    this.timeline.draw();
    this.pictures.show();
    this.link();
  }

  /** Select a track, and look at it where its evidence is strongest. @param {number} id */
  visit(id) {
    const track = facts.tracks.find((/** @type {any} */ each) => each.id === id);
    this.select(id);
    if (track) this.show(track.frame);
    this.viewer.look();
  }

  /** Select the next track of the list, and look at it. @param {number} step */
  next(step) {
    const ids = facts.tracks.map((/** @type {any} */ each) => each.id);
    if (!ids.length) return;
    const now = ids.indexOf(this.viewer.selected);
    this.visit(ids[(now + step + ids.length) % ids.length]);
    one(`details.track[data-track="${this.viewer.selected}"]`)?.scrollIntoView({ block: "nearest" });
  }

  /** Select the track whose box is at a pixel of a pane. @param {number} pane @param {number} x @param {number} y */
  pick(pane, x, y) {
    const found = this.viewer.trackAt(pane, x, y);
    if (found !== null) this.select(found);
  }

  /** Name a problem where the points would be. @param {number} index @param {string} problem */
  fail(index, problem) {
    this.problem = problem;
    if (index >= 0 && index !== this.viewer.frame) return;
    this.loading.hidden = false;
    this.loading.textContent = `These points cannot be shown: ${problem}. The record and the verdict still work.`;
  }

  /** Write frame and track into the address, so that it can be sent. */
  link() {
    clearTimeout(this.saving);
    this.saving = window.setTimeout(() => {
      place.searchParams.set("frame", String(this.viewer.frame));
      if (this.viewer.selected !== null) place.searchParams.set("track", String(this.viewer.selected));
      history.replaceState(null, "", place);
    }, 250);
  }

  /** Connect the buttons, and show what they are set to. */
  tools() {
    for (const each of all("button[data-layout]")) each.onclick = () => this.arrange(each.dataset.layout);
    for (const each of all("[data-by]")) each.onclick = () => this.restyle({ by: each.dataset.by });
    for (const each of all("[data-toggle]")) each.onclick = () => this.toggle(each.dataset.toggle);
    for (const each of all("details.track")) {
      each.querySelector("summary").addEventListener("click", (/** @type {Event} */ event) => {
        event.preventDefault();
        this.visit(Number(each.dataset.track));
      });
    }
    this.restyle({ safe: localStorage.getItem(SAFE) === "yes" });
    this.arrange("both");
  }

  /** @param {"both" | "space" | "top" | "labels"} layout */
  arrange(layout) {
    one("#panes").dataset.layout = layout;
    this.viewer.arrange(layout);
    for (const each of all("button[data-layout]")) {
      each.setAttribute("aria-pressed", String(each.dataset.layout === layout));
    }
    this.legend();
    for (const [id, name] of [["#left-name", "Supervised labels"], ["#right-name", "Self-supervised labels"]]) {
      one(id).hidden = layout !== "labels";
      one(id).textContent = name;
    }
  }

  /** @param {Partial<import("./colours.js").Style>} change */
  restyle(change) {
    this.viewer.restyle(change);
    const { style } = this.viewer;
    for (const each of all("[data-by]")) {
      each.setAttribute("aria-pressed", String(each.dataset.by === style.by));
    }
    document.documentElement.classList.toggle("safe-colours", style.safe);
    const on = { safe: style.safe, alone: !this.viewer.everyTrack, ground: style.ground !== "dim" };
    for (const [name, value] of Object.entries(on)) {
      one(`[data-toggle="${name}"]`).setAttribute("aria-pressed", String(value));
    }
    this.legend();
    this.timeline.draw();
    this.pictures.draw();
  }

  /** Name the colours that are shown. */
  legend() {
    const { style, layout } = this.viewer;
    const by = layout === "labels" ? /** @type {const} */ ("labels") : style.by;
    one("#legend").replaceChildren(
      ...legend({ ...style, by }, facts.task).map(({ name, colour }) => {
        const item = document.createElement("li");
        const swatch = document.createElement("i");
        swatch.style.background = css(colour);
        item.append(swatch, name);
        return item;
      }),
    );
    const ofWitness = facts.tracks.find((/** @type {any} */ each) => each.witness);
    if (by === "outcome" && ofWitness) {
      const item = document.createElement("li");
      const swatch = document.createElement("i");
      swatch.style.background = css(style.safe ? ofWitness.safe : ofWitness.ink);
      item.append(swatch, "box: free space alone: dynamic");
      one("#legend").append(item);
    }
  }

  /** @param {string} name */
  toggle(name) {
    const { style } = this.viewer;
    if (name === "safe") {
      this.restyle({ safe: !style.safe });
      localStorage.setItem(SAFE, style.safe ? "yes" : "no");
    }
    if (name === "ground") {
      const turn = /** @type {const} */ ({ dim: "full", full: "hidden", hidden: "dim" });
      this.restyle({ ground: turn[style.ground] });
    }
    if (name === "alone") {
      this.viewer.everyTrack = !this.viewer.everyTrack;
      this.restyle({});
    }
  }

  /** Hide or show boxes and numbers. @param {boolean} shown */
  marks(shown) {
    if (this.viewer.labels === shown) return;
    this.viewer.labels = shown;
    this.viewer.draw();
    this.pictures.draw();
  }

  /** Act on a key of the view; false where it is none. @param {string} key */
  key(key) {
    const { viewer } = this;
    const pane = document.activeElement === one("#right") ? 1 : 0;
    /** @type {Record<string, () => void>} */
    const actions = {
      ArrowLeft: () => this.show(viewer.frame - 1),
      ArrowRight: () => this.show(viewer.frame + 1),
      Home: () => this.show(0),
      End: () => this.show(facts.frames.length - 1),
      " ": () => this.timeline.play(),
      "[": () => this.next(-1),
      "]": () => this.next(1),
      a: () => viewer.turn(TURN, 0, pane),
      d: () => viewer.turn(-TURN, 0, pane),
      w: () => viewer.turn(0, TURN, pane),
      s: () => viewer.turn(0, -TURN, pane),
      "+": () => viewer.zoom(1 / 1.2),
      "=": () => viewer.zoom(1 / 1.2),
      "-": () => viewer.zoom(1.2),
      f: () => viewer.look(),
      t: () => this.arrange(viewer.layout === "top" ? "both" : "top"),
      e: () => viewer.ego(),
      l: () => this.arrange(viewer.layout === "labels" ? "both" : "labels"),
      x: () => this.restyle({ by: viewer.style.by === "outcome" ? "witness" : "outcome" }),
      c: () => this.toggle("safe"),
      g: () => this.toggle("ground"),
      o: () => this.toggle("alone"),
      v: () => this.marks(false),
    };
    const action = actions[key.length === 1 ? key.toLowerCase() : key];
    action?.();
    return action !== undefined;
  }

  /** Return to both views; false where they are shown. */
  back() {
    if (this.viewer.layout === "both") return false;
    this.arrange("both");
    return true;
  }
}

if (facts) page = new Page();

/** Act on a key of the page; false where it is none. @param {KeyboardEvent} event */
function act(event) {
  const { key } = event;
  if (/^[0-9]$/.test(key)) judge.digit(Number(key));
  else if (key === "Enter") judge.save();
  else if (key === "j" || key === "J") follow(order.next);
  else if (key === "k" || key === "K") follow(order.previous);
  else if (key === "n" || key === "N") judge.note.focus();
  else if (key === "m" || key === "M") judge.ownCause();
  else if (key === "Escape") judge.clear() || page?.back() || location.assign(order.list);
  else return page?.key(key) ?? false;
  return true;
}

/** @param {string} href */
function follow(href) {
  if (href) location.assign(href);
  else judge.tell("this is the end of the list");
}

/** True where a key belongs to a field; choices and the scrubber are none. @param {KeyboardEvent} event */
function isField(event) {
  const at = event.target;
  if (at instanceof HTMLInputElement && /^(radio|range)$/.test(at.type)) {
    if (document.querySelector("dialog[open]") || event.ctrlKey || event.metaKey || event.altKey) return true;
    return at.type === "range" ? /^(Arrow|Home|End|Page)/.test(event.key) : /^(Arrow|Enter| )/.test(event.key);
  }
  return isTyping(event);
}

document.addEventListener("keydown", (event) => {
  const at = /** @type {HTMLElement} */ (event.target);
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "z" && !at.matches("input:not([type=radio]), textarea")) {
    event.preventDefault();
    judge.undo();
    return;
  }
  if (event.key === "Escape" && at === judge.note) {
    at.blur();
    return;
  }
  if (isField(event)) return;
  if (/^(Enter| )$/.test(event.key) && at.matches("button, a, summary")) return;
  if (event.key === "Escape" && document.querySelector("details.menu[open]")) return;
  if (act(event)) event.preventDefault();
});
document.addEventListener("keyup", (event) => {
  if (event.key.toLowerCase() === "v") page?.marks(true);
});
addEventListener("blur", () => page?.marks(true));

for (const each of all("[data-copy]")) {
  each.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(each.dataset.copy);
      each.textContent = "Copied";
    } catch {
      getSelection()?.selectAllChildren(each.previousElementSibling);
    }
  });
}

document.documentElement.dataset.keys = "ready";
