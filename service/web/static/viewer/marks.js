// @ts-check
/** Marks over the points: boxes, paths and numbers of tracks, rings of distance, the vehicle. */

import { NEAR_M, apply, rowsOf } from "./camera.js";
import { css } from "./colours.js";

/** @typedef {import("./camera.js").Place} Place */
/** @typedef {import("./colours.js").Rgb} Rgb */
/**
 * A track of the record.
 * @typedef {object} Track
 * @property {number} id
 * @property {number} frame Frame with its strongest evidence.
 * @property {string} label
 * @property {string} verdict Who errs, with the probability.
 * @property {boolean} strong True for a reason of the score; weaker ones are drawn when selected.
 * @property {Rgb} ink
 * @property {Rgb} safe
 * @property {number[][]} boxes Frame, centre x, y, z, length, width, height and yaw, in turn.
 */

const EDGES = [
  [0, 1], [1, 3], [3, 2], [2, 0], [4, 5], [5, 7], [7, 6], [6, 4], [0, 4], [1, 5], [2, 6], [3, 7],
];
const NOSE = [[1.8, 0, -1.2], [-1.3, 1, -1.2], [-0.7, 0, -1.2], [-1.3, -1, -1.2]];

/**
 * Return the eight corners of a box, sensor space; bit 0: ahead, bit 1: left, bit 2: above.
 * @param {number[]} box Centre, size and yaw.
 * @param {number} margin Metres.
 * @returns {Place[]}
 */
export function corners([x, y, z, length, width, height, yaw], margin = 0) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return Array.from({ length: 8 }, (_, i) => {
    const along = (i & 1 ? 0.5 : -0.5) * (length + 2 * margin);
    const across = (i & 2 ? 0.5 : -0.5) * (width + 2 * margin);
    const up = (i & 4 ? 0.5 : -0.5) * (height + 2 * margin);
    return [x + c * along - s * across, y + s * along + c * across, z + up];
  });
}

/**
 * Return a track's box in a frame, or the one nearest in time.
 * @param {Track} track
 * @param {number} frame
 */
export function boxAt(track, frame) {
  let best = track.boxes[0];
  for (const box of track.boxes) {
    if (Math.abs(box[0] - frame) < Math.abs(best[0] - frame)) best = box;
  }
  return best;
}

/** Draws marks on one canvas by the rows of its camera. */
export class Marks {
  /**
   * @param {CanvasRenderingContext2D} context
   * @param {number[][]} rows Rows of the camera.
   * @param {boolean} flat
   * @param {number} width
   * @param {number} height
   * @param {number} ratio
   */
  constructor(context, rows, flat, width, height, ratio) {
    this.context = context;
    this.rows = rows;
    this.flat = flat;
    this.width = width;
    this.height = height;
    this.ratio = ratio;
    /** @type {number[][]} */
    this.taken = [];
    context.lineJoin = "round";
    context.lineCap = "round";
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  /** Map a place of the camera's space to pixels. @param {Place} at */
  #screen(at) {
    const by = this.flat ? 1 : at[2];
    return [at[0] / by + this.width / 2, at[1] / by + this.height / 2];
  }

  /**
   * Return the pixel of a place in odom space, or null where it is behind the viewer.
   * @param {ArrayLike<number>} place
   */
  pixel(place) {
    const at = apply(this.rows, place);
    return !this.flat && at[2] < NEAR_M ? null : this.#screen(at);
  }

  /**
   * Add a line to the current path, cut where it comes too near.
   * @param {ArrayLike<number>} from
   * @param {ArrayLike<number>} to
   */
  line(from, to) {
    let a = apply(this.rows, from);
    let b = apply(this.rows, to);
    if (!this.flat) {
      if (a[2] < NEAR_M && b[2] < NEAR_M) return;
      if (a[2] < NEAR_M) a = cut(b, a);
      if (b[2] < NEAR_M) b = cut(a, b);
    }
    const [ax, ay] = this.#screen(a);
    const [bx, by] = this.#screen(b);
    this.context.moveTo(ax, ay);
    this.context.lineTo(bx, by);
  }

  /**
   * Draw rings of distance around the sensor, and its vehicle.
   * @param {ArrayLike<number>} pose
   * @param {boolean} names
   */
  ego(pose, names) {
    const rows = rowsOf(pose);
    const { context, ratio } = this;
    context.lineWidth = ratio;
    context.strokeStyle = "rgb(120 130 150 / 0.28)";
    context.fillStyle = "rgb(150 158 172 / 0.8)";
    context.font = `${11 * ratio}px system-ui, sans-serif`;
    for (const radius of [10, 20, 30, 40, 60, 80]) {
      context.beginPath();
      /** @type {Place | null} */
      let last = null;
      for (let i = 0; i <= 64; i++) {
        const angle = (i / 32) * Math.PI;
        const at = apply(rows, [radius * Math.cos(angle), radius * Math.sin(angle), -1.7]);
        if (last) this.line(last, at);
        last = at;
      }
      context.stroke();
      const at = names && last && this.pixel(last);
      if (at) context.fillText(`${radius} m`, at[0] + 3 * ratio, at[1] - 3 * ratio);
    }
    context.beginPath();
    NOSE.forEach((point, i) => this.line(apply(rows, point), apply(rows, NOSE[(i + 1) % 4])));
    context.lineWidth = 2 * ratio;
    context.strokeStyle = "rgb(245 245 245)";
    context.stroke();
  }

  /**
   * Draw the path of a track over the scene.
   * @param {Track} track
   * @param {ArrayLike<number>[]} poses Of each frame.
   * @param {Rgb} ink
   * @param {boolean} selected
   */
  path(track, poses, ink, selected) {
    const { context, ratio } = this;
    const places = track.boxes.map((box) => apply(rowsOf(poses[box[0]]), box.slice(1, 4)));
    context.beginPath();
    for (let i = 1; i < places.length; i++) this.line(places[i - 1], places[i]);
    context.lineWidth = (selected ? 2.5 : 1.2) * ratio;
    context.strokeStyle = css(ink, selected ? 0.9 : 0.5);
    context.stroke();
  }

  /**
   * Draw the box of a track. Where it does not contradict in this frame only the selected one is
   * drawn, dashed.
   * @param {Track} track
   * @param {number} frame
   * @param {ArrayLike<number>[]} poses
   * @param {Rgb} ink
   * @param {boolean} selected
   */
  box(track, frame, poses, ink, selected) {
    const box = boxAt(track, frame);
    if (!box) return;
    const { context, ratio } = this;
    const here = box[0] === frame;
    if (!here && !selected) return;
    const rows = rowsOf(poses[box[0]]);
    const places = corners(box.slice(1), 0.12).map((corner) => apply(rows, corner));
    context.setLineDash(here ? [] : [4 * ratio, 4 * ratio]);
    context.beginPath();
    for (const [a, b] of EDGES) {
      if (!this.flat || (a >= 4 && b >= 4)) this.line(places[a], places[b]);
    }
    if (selected && here) {
      context.lineWidth = 6 * ratio;
      context.strokeStyle = "rgb(0 0 0 / 0.55)";
      context.stroke();
    }
    context.lineWidth = (selected ? 2.6 : 1.4) * ratio;
    context.strokeStyle = css(ink, here ? 1 : 0.55);
    context.stroke();
    context.setLineDash([]);
  }

  /**
   * Return left, top, right and bottom of a track's box; null where it is behind the viewer.
   * @param {Track} track
   * @param {number} frame
   * @param {ArrayLike<number>[]} poses
   */
  extent(track, frame, poses) {
    const box = boxAt(track, frame);
    if (!box) return null;
    const rows = rowsOf(poses[box[0]]);
    const at = corners(box.slice(1), 0.12).map((corner) => this.pixel(apply(rows, corner)));
    const [us, vs] = [0, 1].map((axis) => at.map((pixel) => pixel?.[axis] ?? NaN));
    if (us.some(Number.isNaN)) return null;
    return [Math.min(...us), Math.min(...vs), Math.max(...us), Math.max(...vs)];
  }

  /**
   * Draw the number of a track above its box, where there is room.
   * @param {Track} track
   * @param {number} frame
   * @param {ArrayLike<number>[]} poses
   * @param {Rgb} ink
   * @param {boolean} selected
   */
  name(track, frame, poses, ink, selected) {
    const extent = this.extent(track, frame, poses);
    if (!extent || (!selected && boxAt(track, frame)[0] !== frame)) return;
    const { context, ratio } = this;
    const roomy = this.width > 420 * ratio;
    const words = selected && roomy && track.verdict ? `${track.label} · ${track.verdict}` : track.label;
    const size = (selected && roomy ? 15 : 12) * ratio;
    context.font = `${selected ? 650 : 550} ${size}px system-ui, sans-serif`;
    const wide = context.measureText(words).width + size;
    const tall = size * 1.55;
    const [left, top, right, bottom] = extent;
    if (right < 0 || left > this.width || bottom < 0 || top > this.height) return;
    const middle = (left + right - wide) / 2;
    const spots = [
      [middle, top - tall - 5 * ratio], [middle, bottom + 5 * ratio],
      [right + 5 * ratio, top], [left - wide - 5 * ratio, top],
    ].map(([x, y]) => [x, y, x + wide, y + tall]);
    const spot = spots.find((each) => this.#free(each)) ?? (selected ? this.#inside(spots[0]) : null);
    if (!spot) return;
    this.taken.push(spot);
    context.beginPath();
    context.roundRect(spot[0], spot[1], wide, tall, 4 * ratio);
    context.fillStyle = selected ? css(ink) : "rgb(10 11 14 / 0.86)";
    context.fill();
    context.lineWidth = 1.2 * ratio;
    context.strokeStyle = css(ink);
    context.stroke();
    context.fillStyle = selected ? "rgb(10 11 14)" : css(ink);
    context.textBaseline = "middle";
    context.fillText(words, spot[0] + size / 2, spot[1] + tall / 2 + ratio / 2);
    context.textBaseline = "alphabetic";
  }

  /** @param {number[]} spot */
  #free([left, top, right, bottom]) {
    if (left < 0 || top < 0 || right > this.width || bottom > this.height) return false;
    return this.taken.every((t) => right < t[0] || left > t[2] || bottom < t[1] || top > t[3]);
  }

  /** Shift a spot into the view. @param {number[]} spot */
  #inside([left, top, right, bottom]) {
    const x = Math.max(0, Math.min(left, this.width - (right - left)));
    const y = Math.max(0, Math.min(top, this.height - (bottom - top)));
    return [x, y, x + right - left, y + bottom - top];
  }
}

/**
 * Return the place on a line where it is just far enough from the viewer.
 * @param {Place} far
 * @param {Place} near
 * @returns {Place}
 */
function cut(far, near) {
  const t = (far[2] - NEAR_M) / (far[2] - near[2]);
  return [far[0] + (near[0] - far[0]) * t, far[1] + (near[1] - far[1]) * t, NEAR_M];
}
