// @ts-check
/** Loader of frames: the strongest first, then its neighbours, a few requests at a time. */

import { decodeView, isCompressed } from "./codec.js";

/** @typedef {import("./codec.js").Frame} Frame */

const AT_ONCE = 3;

/** Points that the page keeps: 240 MB. Of a larger scene only frames near the shown one are kept. */
export const MOST_POINTS = 30_000_000;

/**
 * Order frames by their distance from one.
 * @param {number} count
 * @param {number} first
 */
export function order(count, first) {
  return Array.from({ length: count }, (_, i) => i).sort(
    (a, b) => Math.abs(a - first) - Math.abs(b - first) || a - b,
  );
}

/** Started with the module. The first block does not wait for it: the page decodes that itself. */
const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
let isReady = false;

export class Frames {
  /**
   * @param {{points: number}[]} list Frames of the scene.
   * @param {(index: number) => string} url Address of a frame's block.
   * @param {(index: number, frame: Frame) => void} onFrame
   * @param {(index: number, problem: string) => void} onProblem
   * @param {(index: number) => void} onDrop
   */
  constructor(list, url, onFrame, onProblem, onDrop) {
    this.list = list;
    this.url = url;
    this.onFrame = onFrame;
    this.onProblem = onProblem;
    this.onDrop = onDrop;
    /** @type {number[]} */
    this.waiting = [];
    this.running = 0;
    this.hasFirst = false;
    /** @type {Set<number>} */
    this.asked = new Set();
    this.worker = worker;
    this.worker.addEventListener("message", ({ data }) => {
      if (data.ready) isReady = true;
      else if (data.problem) onProblem(data.index, data.problem);
      else onFrame(data.index, data.frame);
    });
    this.worker.addEventListener("error", () => onProblem(-1, "The decoder did not start."));
  }

  /**
   * Load every frame that is not there yet, one and its neighbours first.
   * @param {number} first
   */
  load(first) {
    const near = new Set();
    let points = 0;
    for (const i of order(this.list.length, first)) {
      points += this.list[i].points;
      if (points <= MOST_POINTS || i === first) near.add(i);
    }
    for (const i of this.asked) {
      if (!near.has(i)) {
        this.asked.delete(i);
        this.onDrop(i);
      }
    }
    this.waiting = [...near].filter((i) => !this.asked.has(i));
    this.#fill();
  }

  /** Ask for frames; for the first one alone, so that nothing delays it. */
  #fill() {
    const most = this.hasFirst ? AT_ONCE : 1;
    while (this.running < most && this.waiting.length) this.#next();
  }

  async #next() {
    const index = /** @type {number} */ (this.waiting.shift());
    this.asked.add(index);
    this.running++;
    try {
      const answer = await fetch(this.url(index));
      if (!answer.ok) throw new Error((await answer.json()).problem);
      const [buffer, { points }] = [await answer.arrayBuffer(), this.list[index]];
      const bytes = new Uint8Array(buffer);
      if (!isReady && !this.hasFirst && !isCompressed(bytes)) {
        this.onFrame(index, decodeView(bytes, points));
      } else {
        this.worker.postMessage({ index, buffer, count: points }, [buffer]);
      }
    } catch (error) {
      this.onProblem(index, error instanceof Error ? error.message : String(error));
    }
    this.running--;
    this.hasFirst = true;
    this.#fill();
  }
}
