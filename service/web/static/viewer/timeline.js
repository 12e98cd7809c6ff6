// @ts-check
/** Time line: a scrubber, play, and a strip of when each track contradicts. */

import { css } from "./colours.js";

/** @typedef {import("./viewer.js").Viewer} Viewer */

const ROW = 11;
const GAP = 2;
const MOST_ROWS = 5;
const FASTEST_MS = 60;

export class Timeline {
  /**
   * @param {Viewer} viewer
   * @param {(frame: number) => void} onFrame
   * @param {(track: number) => void} onTrack
   */
  constructor(viewer, onFrame, onTrack) {
    this.viewer = viewer;
    this.onFrame = onFrame;
    this.scrub = /** @type {HTMLInputElement} */ (document.querySelector("#scrub"));
    this.strip = /** @type {HTMLCanvasElement} */ (document.querySelector("#strip"));
    this.moment = /** @type {HTMLOutputElement} */ (document.querySelector("#moment"));
    this.button = /** @type {HTMLButtonElement} */ (document.querySelector("#play"));
    this.timer = 0;
    this.scrub.addEventListener("input", () => onFrame(Number(this.scrub.value)));
    this.button.addEventListener("click", () => this.play());
    this.strip.addEventListener("click", (event) => {
      const { frames } = viewer.scene;
      onFrame(Math.floor((event.offsetX / this.strip.clientWidth) * frames.length));
      const track = this.rows()[Math.floor(event.offsetY / (ROW + GAP))];
      if (track) onTrack(track.id);
    });
    new ResizeObserver(() => this.draw()).observe(this.strip);
  }

  /** Tracks with a row: the strongest ones, and the selected one in any case. */
  rows() {
    const { tracks } = this.viewer.scene;
    const rows = tracks.filter((each, i) => each.strong || i === 0).slice(0, MOST_ROWS);
    const chosen = tracks.find((each) => each.id === this.viewer.selected);
    if (chosen && !rows.includes(chosen)) rows.splice(MOST_ROWS - 1, 1, chosen);
    return rows;
  }

  /** Start or stop to play. */
  play() {
    if (this.timer) {
      clearTimeout(this.timer);
      this.timer = 0;
    } else {
      this.#step();
    }
    const name = this.timer ? "Pause" : "Play";
    this.button.textContent = this.timer ? "❚❚" : "▶";
    this.button.setAttribute("aria-label", name);
  }

  #step() {
    const { frames } = this.viewer.scene;
    const now = this.viewer.frame;
    const next = (now + 1) % frames.length;
    const gap = next ? 1000 * (frames[next].seconds - frames[now].seconds) : 700;
    this.timer = window.setTimeout(() => {
      this.onFrame(next);
      this.#step();
    }, Math.max(FASTEST_MS, Math.min(gap, 1000)));
  }

  /** Show where in time the view is, and draw the strip. */
  draw() {
    const rows = this.rows();
    this.strip.style.height = `${Math.max(1, rows.length) * (ROW + GAP)}px`;
    const { frame, scene, selected, style, frames } = this.viewer;
    this.scrub.value = String(frame);
    const { seconds } = scene.frames[frame];
    this.moment.textContent = `${seconds.toFixed(1)} s`;
    this.scrub.setAttribute("aria-valuetext", `${seconds.toFixed(1)} seconds, frame ${frame}`);
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = [this.strip.clientWidth * ratio, this.strip.clientHeight * ratio];
    if (!width) return;
    if (this.strip.width !== width) this.strip.width = width;
    if (this.strip.height !== height) this.strip.height = height;
    const context = /** @type {CanvasRenderingContext2D} */ (this.strip.getContext("2d"));
    context.clearRect(0, 0, width, height);
    const cell = width / scene.frames.length;
    rows.forEach((track, row) => {
      const top = row * (ROW + GAP) * ratio;
      const here = new Set(track.boxes.map((box) => box[0]));
      const ink = style.safe ? track.safe : track.ink;
      const strong = track.id === selected;
      scene.frames.forEach((_, i) => {
        const share = here.has(i) ? (strong ? 1 : 0.5) : strong ? 0.16 : 0.07;
        context.fillStyle = css(here.has(i) ? ink : [128, 136, 150], here.has(i) ? share : share + 0.1);
        context.fillRect(i * cell + ratio / 2, top, Math.max(1, cell - ratio), ROW * ratio);
      });
      context.font = `650 ${10 * ratio}px system-ui, sans-serif`;
      context.fillStyle = strong ? "rgb(10 11 14)" : getComputedStyle(this.strip).color;
      const begin = track.boxes[0][0] * cell;
      context.fillText(String(track.id + 1), begin + 4 * ratio, top + 9 * ratio);
    });
    context.fillStyle = "rgb(128 136 150 / 0.35)";
    scene.frames.forEach((_, i) => {
      if (!frames[i]) context.fillRect(i * cell, height - ratio, cell, ratio);
    });
    context.lineWidth = 2 * ratio;
    context.strokeStyle = getComputedStyle(this.strip).color;
    context.strokeRect(frame * cell, ratio, cell, height - 2 * ratio);
  }
}
