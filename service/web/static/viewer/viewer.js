// @ts-check
/** Viewer of a scene: `put` frames, `show` one, `look` at a track, `turn` the camera. */

import { Camera, apply, fromSensor, rowsOf } from "./camera.js";
import { OF_TRACK, SELECTED } from "./codec.js";
import { BACKGROUND, table } from "./colours.js";
import { Marks, boxAt } from "./marks.js";
import { Surface } from "./raster.js";

/** @typedef {import("./codec.js").Frame} Frame */
/** @typedef {import("./colours.js").Style} Style */
/** @typedef {import("./marks.js").Track} Track */
/** @typedef {"both" | "space" | "top" | "labels"} Layout */
/**
 * The scene that is shown.
 * @typedef {object} Scene
 * @property {{classes: string[], outcomes: any[]}} task
 * @property {{pose: number[], seconds: number, points: number}[]} frames
 * @property {Track[]} tracks
 * @property {number[]} owners The track of each instance; -1 for one that the record leaves out.
 */

/** One canvas with its camera. */
class Pane {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Camera} camera
   */
  constructor(canvas, camera) {
    this.canvas = canvas;
    this.camera = camera;
    this.surface = new Surface();
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    /** @type {Style["by"] | ""} */
    this.by = "";
  }

  /** Fit the pixels to the size on the page. @param {number} ratio */
  fit(ratio) {
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    this.surface.resize(width, height);
  }
}

export class Viewer {
  /**
   * @param {HTMLCanvasElement[]} canvases Two, side by side.
   * @param {Scene} scene
   * @param {(drawn: {frame: number, points: number}) => void} onDraw
   */
  constructor(canvases, scene, onDraw) {
    this.scene = scene;
    this.onDraw = onDraw;
    this.space = new Camera(false);
    this.top = new Camera(true);
    this.panes = [new Pane(canvases[0], this.space), new Pane(canvases[1], this.top)];
    /** @type {(Frame | undefined)[]} */
    this.frames = scene.frames.map(() => undefined);
    this.frame = 0;
    /** @type {number | null} */
    this.selected = null;
    this.everyTrack = true;
    this.labels = true;
    /** @type {Layout} */
    this.layout = "both";
    /** @type {Style} */
    this.style = { by: "outcome", safe: false, ground: "dim" };
    /** @type {Map<string, ReturnType<typeof table>>} */
    this.tables = new Map();
    this.waiting = false;
    new ResizeObserver(() => this.draw()).observe(canvases[0]);
    new ResizeObserver(() => this.draw()).observe(canvases[1]);
  }

  /**
   * Keep a decoded frame.
   * @param {number} index
   * @param {Frame} frame
   */
  put(index, frame) {
    this.frames[index] = frame;
    this.#mark(frame);
    if (index === this.frame) this.draw();
  }

  /** Forget the points of a frame. @param {number} index */
  drop(index) {
    this.frames[index] = undefined;
  }

  /** Show a frame. @param {number} index */
  show(index) {
    this.frame = Math.max(0, Math.min(this.frames.length - 1, index));
    this.draw();
  }

  /**
   * Select a track, or none.
   * @param {number | null} id
   */
  select(id) {
    this.selected = id;
    for (const frame of this.frames) if (frame) this.#mark(frame);
    this.draw();
  }

  /** Point both cameras at a track, seen from the vehicle's side; without one, at the vehicle. */
  look() {
    const track = this.scene.tracks.find((each) => each.id === this.selected);
    const box = track && boxAt(track, this.frame);
    const pose = this.scene.frames[box ? box[0] : this.frame].pose;
    const ego = [pose[3], pose[7], pose[11]];
    const heading = Math.atan2(pose[4], pose[0]);
    const target = box ? apply(rowsOf(pose), box.slice(1, 4)) : apply(rowsOf(pose), [12, 0, -1]);
    const [dx, dy] = [target[0] - ego[0], target[1] - ego[1]];
    const away = Math.hypot(dx, dy);
    const size = box ? Math.max(box[4], box[5], box[6]) : 30;
    const way = track ? wayOf(track, this.scene) : 0;
    this.space.target = [target[0], target[1], target[2]];
    this.space.yaw = box && away > 2 ? Math.atan2(dy, dx) : heading;
    this.space.pitch = box ? 0.42 : 0.6;
    this.space.distance = box ? Math.min(60, Math.max(9, 2.9 * size, 0.9 * way)) : 45;
    this.top.target = [target[0], target[1], target[2]];
    this.top.yaw = heading;
    this.top.distance = box ? Math.min(120, Math.max(30, 6 * size, 1.6 * way)) : 80;
    if (box && away < 45) {
      const { clientWidth: wide, clientHeight: tall } = this.panes[1].canvas;
      const shape = Math.max(0.4, Math.min(1, wide / Math.max(1, tall)));
      this.top.distance = Math.max(this.top.distance, (1.15 * (away + size + 5)) / shape);
      this.top.target[0] -= dx / 2;
      this.top.target[1] -= dy / 2;
    }
    this.draw();
  }

  /**
   * Return the track whose box is at a pixel, the smallest one; null where there is none.
   * @param {number} index Pane.
   * @param {number} x
   * @param {number} y
   */
  trackAt(index, x, y) {
    const pane = this.panes[index];
    const ratio = window.devicePixelRatio || 1;
    const { width, height } = pane.surface;
    const marks = new Marks(pane.context, pane.camera.rows(height), pane.camera.flat, width, height, ratio);
    let [best, least] = [/** @type {number | null} */ (null), Infinity];
    for (const [track] of this.#shown()) {
      const spot = marks.extent(track, this.frame, this.scene.frames.map((each) => each.pose));
      if (!spot) continue;
      const [left, top, right, bottom] = spot.map((value) => value / ratio);
      const size = (right - left) * (bottom - top);
      if (x > left - 6 && x < right + 6 && y > top - 6 && y < bottom + 6 && size < least) {
        [best, least] = [track.id, size];
      }
    }
    return best;
  }

  /** Look from the vehicle towards the selected track, or ahead. */
  ego() {
    const { pose } = this.scene.frames[this.frame];
    const track = this.scene.tracks.find((each) => each.id === this.selected);
    const box = track && boxAt(track, this.frame);
    const angle = box ? Math.atan2(box[2], box[1]) : 0;
    this.space.target = apply(rowsOf(pose), [9 * Math.cos(angle), 9 * Math.sin(angle), 0.2]);
    this.space.yaw = Math.atan2(pose[4], pose[0]) + angle;
    this.space.pitch = 0.16;
    this.space.distance = 13;
    this.draw();
  }

  /**
   * Turn the camera of a pane, radians.
   * @param {number} yaw
   * @param {number} pitch
   * @param {number} [pane]
   */
  turn(yaw, pitch, pane = 0) {
    this.panes[pane].camera.turn(yaw, pitch);
    this.draw();
  }

  /**
   * Zoom the camera of a pane, or of both.
   * @param {number} factor
   * @param {number} [pane]
   */
  zoom(factor, pane) {
    const cameras = pane === undefined ? [this.space, this.top] : [this.panes[pane].camera];
    for (const camera of cameras) camera.zoom(factor);
    this.draw();
  }

  /**
   * Arrange the panes: both views, one of them, or both streams' labels from the same place.
   * @param {Layout} layout
   */
  arrange(layout) {
    this.layout = layout;
    const [left, right] = this.panes;
    left.camera = layout === "top" ? this.top : this.space;
    right.camera = layout === "labels" ? this.space : this.top;
    left.by = layout === "labels" ? "supervised" : "";
    right.by = layout === "labels" ? "selfsupervised" : "";
    this.draw();
  }

  /** Change colours. @param {Partial<Style>} change */
  restyle(change) {
    Object.assign(this.style, change);
    this.tables.clear();
    this.draw();
  }

  /** Draw at the next animation frame, once. */
  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.paint();
    });
  }

  /** Draw now; nothing before the first frame, whose way to the page it would only delay. */
  paint() {
    if (!this.frames.some((each) => each)) return;
    const ratio = window.devicePixelRatio || 1;
    for (const pane of this.panes) {
      if (pane.canvas.clientWidth) this.#paint(pane, ratio);
    }
    this.onDraw({ frame: this.frame, points: this.frames[this.frame]?.count ?? 0 });
  }

  /**
   * @param {Pane} pane
   * @param {number} ratio
   */
  #paint(pane, ratio) {
    pane.fit(ratio);
    const { surface, camera, context } = pane;
    const rows = camera.rows(surface.height);
    const poses = this.scene.frames.map((each) => each.pose);
    const frame = this.frames[this.frame];
    surface.clear(BACKGROUND);
    if (frame) {
      const matrix = fromSensor(rows, poses[this.frame]);
      surface.draw(frame.points, matrix, camera.flat, this.#table(pane.by || this.style.by), ratio);
    }
    context.putImageData(surface.image, 0, 0);
    const marks = new Marks(context, rows, camera.flat, surface.width, surface.height, ratio);
    marks.ego(poses[this.frame], camera.flat);
    if (!this.labels) return;
    const shown = this.#shown();
    for (const [track, ink, selected] of shown) marks.path(track, poses, ink, selected);
    for (const [track, ink, selected] of shown) marks.box(track, this.frame, poses, ink, selected);
    for (const [track, ink, selected] of shown.reverse()) {
      marks.name(track, this.frame, poses, ink, selected);
    }
  }

  /**
   * Return the tracks to draw with their inks, the selected one last.
   * @returns {[Track, import("./colours.js").Rgb, boolean][]}
   */
  #shown() {
    const tracks = this.scene.tracks.filter(
      (each) => each.id === this.selected || (this.everyTrack && each.strong),
    );
    tracks.sort((a, b) => Number(a.id === this.selected) - Number(b.id === this.selected) || b.id - a.id);
    return tracks.map((each) => [each, this.style.safe ? each.safe : each.ink, each.id === this.selected]);
  }

  /** @param {Style["by"]} by */
  #table(by) {
    let found = this.tables.get(by);
    if (!found) {
      found = table({ ...this.style, by }, this.scene.task);
      this.tables.set(by, found);
    }
    return found;
  }

  /** Mark points of the record's tracks, and of the selected one. @param {Frame} frame */
  #mark(frame) {
    const { points, members, owners } = frame;
    for (let i = 0; i < members.length; i++) {
      const at = 4 * members[i] + 3;
      const track = this.scene.owners[owners[i]];
      let code = points[at] & ~(OF_TRACK | SELECTED);
      if (track >= 0) code |= OF_TRACK;
      if (track >= 0 && track === this.selected) code |= SELECTED;
      points[at] = code;
    }
  }
}

/**
 * Return the length of a track's way over the scene, metres.
 * @param {Track} track
 * @param {Scene} scene
 */
function wayOf(track, scene) {
  const [first, last] = [track.boxes[0], track.boxes[track.boxes.length - 1]].map((box) =>
    apply(rowsOf(scene.frames[box[0]].pose), box.slice(1, 4)),
  );
  return Math.hypot(last[0] - first[0], last[1] - first[1]);
}
