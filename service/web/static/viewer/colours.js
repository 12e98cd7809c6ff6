// @ts-check
/** Colours of points by their code: one table per colouring, so that a change costs no decoding. */

import { CODES, GROUND, OF_TRACK, SELECTED, UNKNOWN } from "./codec.js";

/** @typedef {[number, number, number]} Rgb */
/**
 * An outcome of the task.
 * @typedef {object} Outcome
 * @property {Rgb} colour
 * @property {Rgb} safe Colour of the set for colour-blind reviewers.
 * @property {boolean} contradicts
 */
/**
 * Choices of a reviewer.
 * @typedef {object} Style
 * @property {"outcome"|"supervised"|"selfsupervised"|"witness"} by
 * @property {boolean} safe
 * @property {"dim"|"full"|"hidden"} ground
 */

export const BACKGROUND = pixel([13, 15, 19]);
/** @type {Rgb} */
const SILENT = [112, 116, 124];
/** @type {Rgb} */
const WITNESS = [232, 130, 250];
/** @type {Rgb} */
const SAW_THROUGH = [70, 150, 160];

/** Return the pixel of a colour. @param {Rgb} rgb @param {number} [share] */
export function pixel(rgb, share = 1) {
  const [r, g, b] = rgb.map((value) => Math.min(255, Math.round(value * share)));
  return ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

/** Return a colour for a style sheet. @param {Rgb} rgb @param {number} [alpha] */
export function css(rgb, alpha = 1) {
  return `rgb(${rgb.join(" ")} / ${alpha})`;
}

/**
 * Build colour and size of every code.
 * @param {Style} style
 * @param {{outcomes: Outcome[], classes: string[]}} task
 */
export function table(style, task) {
  const colours = new Uint32Array(CODES);
  const sizes = new Uint8Array(CODES);
  const many = task.classes.length;
  for (let code = 0; code < CODES; code++) {
    const supervised = code & 15;
    const predicted = (code >> 4) & 15;
    const witness = (code >> 8) & 15;
    if (![supervised, predicted, witness].every((label) => label < many || label === UNKNOWN)) continue;
    const compared = supervised < many && predicted < many;
    const outcome = compared ? predicted * many + supervised : many * many;
    const [rgb, plain] = colourOf(style, task, { supervised, predicted, witness, outcome });
    const chosen = code & (OF_TRACK | SELECTED);
    const ground = (code & GROUND) !== 0 && plain;
    if (ground && style.ground === "hidden") continue;
    let share = plain ? 0.85 : chosen ? 1 : 0.8;
    if (ground) share = style.ground === "dim" ? 0.36 : 0.85;
    if (outcome === many * many && plain) share *= 0.75;
    colours[code] = pixel(rgb, code & SELECTED ? 1.12 : share);
    sizes[code] = code & SELECTED ? 3 : chosen ? 2 : plain ? 1 : 2;
  }
  return { colours, sizes };
}

/**
 * Return a point's colour, and true if it is part of the background.
 * @param {Style} style
 * @param {{outcomes: Outcome[], classes: string[]}} task
 * @param {{supervised: number, predicted: number, witness: number, outcome: number}} of
 * @returns {[Rgb, boolean]}
 */
function colourOf(style, task, of) {
  const many = task.classes.length;
  const plain = of.outcome === 0 || of.outcome === many * many;
  /** @param {number} code @returns {Rgb} */
  const set = (code) => task.outcomes[code][style.safe ? "safe" : "colour"];
  if (style.by === "outcome") return [set(of.outcome), plain];
  if (style.by === "witness") {
    if (of.witness === UNKNOWN) return [SILENT, true];
    return of.witness ? [WITNESS, false] : [SAW_THROUGH, true];
  }
  const label = style.by === "supervised" ? of.supervised : of.predicted;
  if (label >= many) return [SILENT, true];
  return [set(label * many + label), label === 0];
}

/**
 * Name the entries of a colouring for the legend; `labels`: of one stream's labels.
 * @param {{by: Style["by"] | "labels", safe: boolean}} style
 * @param {{outcomes: (Outcome & {meaning: string})[], classes: string[]}} task
 * @returns {{name: string, colour: Rgb}[]}
 */
export function legend(style, task) {
  const many = task.classes.length;
  /** @param {number} code */
  const set = (code) => task.outcomes[code][style.safe ? "safe" : "colour"];
  if (style.by === "outcome") {
    return task.outcomes.slice(0, 12).map((each, code) => ({ name: each.meaning, colour: set(code) }));
  }
  if (style.by === "witness") {
    return [
      { name: "free space: occupied before, so static", colour: SAW_THROUGH },
      { name: "free space: was empty, so dynamic", colour: WITNESS },
      { name: "free space: no label", colour: SILENT },
    ];
  }
  return [
    ...task.classes.map((name, i) => ({ name, colour: set(i * many + i) })),
    { name: "no label", colour: SILENT },
  ];
}
