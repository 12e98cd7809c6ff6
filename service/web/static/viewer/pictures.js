// @ts-check
/** Camera pictures with the numbered boxes of the tracks: the whole picture, and what it is about. */

import { css } from "./colours.js";
import { project } from "./lens.js";
import { corners } from "./marks.js";

/** @typedef {import("./lens.js").Picture} Picture */
/** @typedef {import("./viewer.js").Viewer} Viewer */

const SAMPLES = 12;
const EDGES = [
  [0, 1], [1, 3], [3, 2], [2, 0], [4, 5], [5, 7], [7, 6], [6, 4], [0, 4], [1, 5], [2, 6], [3, 7],
];

export class Pictures {
  /**
   * @param {HTMLElement} place
   * @param {Viewer} viewer
   * @param {Picture[]} list
   * @param {(number: number) => string} url
   */
  constructor(place, viewer, list, url) {
    this.place = place;
    this.viewer = viewer;
    this.list = list;
    this.url = url;
    /** @type {Map<number, HTMLImageElement>} */
    this.images = new Map();
    this.shown = -1;
    if (!list.length) return;
    place.hidden = false;
    this.crop = this.#canvas("What the camera saw at the selected track");
    this.whole = this.#canvas("Camera picture");
    this.caption = document.createElement("p");
    place.append(this.caption);
    new ResizeObserver(() => this.draw()).observe(place);
  }

  /** @param {string} name */
  #canvas(name) {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", name);
    this.place.append(canvas);
    return canvas;
  }

  /** Show the picture that sees the selected track, nearest in time. */
  show() {
    const { frame, selected } = this.viewer;
    let best = -1;
    let least = Infinity;
    this.list.forEach((each, i) => {
      const blind = selected !== null && !each.tracks.includes(selected);
      const cost = Math.abs(each.frame - frame) + (blind ? 1000 : 0);
      if (cost < least) [best, least] = [i, cost];
    });
    this.shown = best;
    if (best < 0) return;
    const seen = selected === null || this.list[best].tracks.includes(selected);
    this.place.classList.toggle("small", !seen);
    if (!this.images.has(best)) {
      const image = new Image();
      image.addEventListener("load", () => this.draw());
      image.src = this.url(best);
      this.images.set(best, image);
    }
    this.draw();
  }

  draw() {
    const image = this.images.get(this.shown);
    if (!image?.complete || !image.naturalWidth || !this.crop || !this.whole) return;
    const picture = this.list[this.shown];
    const around = this.#around(picture);
    this.crop.hidden = !around;
    if (around) this.#paint(this.crop, image, picture, around);
    this.#paint(this.whole, image, picture, [0, 0, picture.width, picture.height]);
    const { seconds } = this.viewer.scene.frames[picture.frame];
    const { selected } = this.viewer;
    const blind = selected !== null && !picture.tracks.includes(selected);
    const where = `${picture.topic.split("/").slice(0, 3).join("/")}, ${seconds.toFixed(1)} s`;
    const words = blind ? `No kept picture shows track ${selected + 1}. ${where}` : where;
    if (this.caption) this.caption.textContent = words;
  }

  /**
   * Return the part of a picture around the selected track; null where it is not seen.
   * @param {Picture} picture
   */
  #around(picture) {
    const track = this.viewer.scene.tracks.find((each) => each.id === this.viewer.selected);
    const box = track?.boxes.find((each) => each[0] === picture.frame);
    if (!box) return null;
    const at = corners(box.slice(1)).flatMap((corner) => project(picture, corner) ?? []);
    if (at.length < 4) return null;
    const [us, vs] = [at.filter((_, i) => i % 2 === 0), at.filter((_, i) => i % 2 === 1)];
    const [left, right] = [Math.min(...us), Math.max(...us)];
    const [top, bottom] = [Math.min(...vs), Math.max(...vs)];
    const side = Math.min(picture.height, Math.max(72, 1.9 * Math.max(right - left, bottom - top)));
    const width = Math.min(picture.width, side * 1.25);
    const x = Math.max(0, Math.min(picture.width - width, (left + right - width) / 2));
    const y = Math.max(0, Math.min(picture.height - side, (top + bottom - side) / 2));
    return [x, y, width, side];
  }

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {HTMLImageElement} image
   * @param {Picture} picture
   * @param {number[]} part
   */
  #paint(canvas, image, picture, [x, y, width, height]) {
    const ratio = window.devicePixelRatio || 1;
    const tall = Math.max(1, this.place.clientHeight - 4);
    canvas.style.height = `${tall}px`;
    canvas.style.width = `${(tall * width) / height}px`;
    canvas.height = Math.round(tall * ratio);
    canvas.width = Math.round((tall * ratio * width) / height);
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    const scale = canvas.height / height;
    const stretch = image.naturalWidth / picture.width;
    context.drawImage(
      image, x * stretch, y * stretch, width * stretch, height * stretch, 0, 0, canvas.width, canvas.height,
    );
    if (!this.viewer.labels) return;
    const { tracks } = this.viewer.scene;
    for (const track of [...tracks].reverse()) {
      const chosen = track.id === this.viewer.selected;
      if (!chosen && !this.viewer.everyTrack) continue;
      for (const box of track.boxes.filter((each) => each[0] === picture.frame)) {
        const ink = this.viewer.style.safe ? track.safe : track.ink;
        const first = this.#outline(context, picture, box.slice(1), [x, y, scale]);
        context.lineWidth = (chosen ? 2.5 : 1.2) * ratio;
        context.strokeStyle = css(ink, chosen ? 1 : 0.8);
        context.stroke();
        if (!first) continue;
        const words = String(track.id + 1);
        const size = (chosen ? 13 : 9) * ratio;
        context.font = `650 ${size}px system-ui, sans-serif`;
        const wide = context.measureText(words).width + size * 0.6;
        context.fillStyle = css(ink, chosen ? 1 : 0.85);
        context.fillRect(first[0], first[1] - 1.4 * size, wide, 1.25 * size);
        context.fillStyle = "rgb(10 11 14)";
        context.fillText(words, first[0] + 0.3 * size, first[1] - 0.45 * size);
      }
    }
  }

  /**
   * Trace the edges of a box, and return its upper left pixel; null where it is not seen.
   * @param {CanvasRenderingContext2D} context
   * @param {Picture} picture
   * @param {number[]} box
   * @param {number[]} to Origin of the part, and scale.
   */
  #outline(context, picture, box, [x, y, scale]) {
    const places = corners(box);
    let [left, top] = [Infinity, Infinity];
    context.beginPath();
    for (const [a, b] of EDGES) {
      let drawing = false;
      for (let i = 0; i <= SAMPLES; i++) {
        const at = places[a].map((value, axis) => value + ((places[b][axis] - value) * i) / SAMPLES);
        const pixel = project(picture, at);
        if (!pixel) {
          drawing = false;
          continue;
        }
        const [u, v] = [(pixel[0] - x) * scale, (pixel[1] - y) * scale];
        if (drawing) context.lineTo(u, v);
        else context.moveTo(u, v);
        drawing = true;
        [left, top] = [Math.min(left, u), Math.min(top, v)];
      }
    }
    return Number.isFinite(left) ? [left, Math.max(top, 17)] : null;
  }
}
