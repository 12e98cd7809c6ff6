// @ts-check
/** Projection of lidar points into a camera picture, with the distortion of the lens. */

const MIN_DEPTH_M = 0.1;
const FISHEYE = ["equidistant", "fisheye", "kannala_brandt"];

/**
 * A kept picture and its calibration.
 * @typedef {object} Picture
 * @property {string} topic
 * @property {number} frame
 * @property {number} width
 * @property {number} height
 * @property {number[]} pixel Projection, three rows of four.
 * @property {number[]} camera The camera from the lidar's sensor space, four rows of four.
 * @property {string} model
 * @property {number[]} lens
 * @property {number[]} tracks
 */

/**
 * Return the pixel of a place in sensor space, or null outside the picture.
 * @param {Picture} picture
 * @param {ArrayLike<number>} at
 */
export function project(picture, at) {
  const { camera: c, pixel: p } = picture;
  let x = c[0] * at[0] + c[1] * at[1] + c[2] * at[2] + c[3];
  let y = c[4] * at[0] + c[5] * at[1] + c[6] * at[2] + c[7];
  const z = c[8] * at[0] + c[9] * at[1] + c[10] * at[2] + c[11];
  if (z <= MIN_DEPTH_M) return null;
  if (picture.lens.length) {
    const bent = distort(x / z, y / z, picture.lens, picture.model);
    if (!bent) return null;
    [x, y] = [bent[0] * z, bent[1] * z];
  }
  const w = p[8] * x + p[9] * y + p[10] * z + p[11];
  const u = (p[0] * x + p[1] * y + p[2] * z + p[3]) / w;
  const v = (p[4] * x + p[5] * y + p[6] * z + p[7]) / w;
  return u >= 0 && v >= 0 && u < picture.width && v < picture.height ? [u, v] : null;
}

/**
 * Bend an ideal ray; null beyond the field of view, where a polynomial turns back.
 * @param {number} x
 * @param {number} y
 * @param {number[]} lens k1 k2 p1 p2 k3 k4 k5 k6, or k1 k2 k3 k4 of a fisheye.
 * @param {string} model
 * @returns {[number, number] | null}
 */
function distort(x, y, lens, model) {
  const radius = Math.hypot(x, y);
  const k = [...lens, 0, 0, 0, 0, 0, 0, 0, 0];
  if (FISHEYE.includes(model)) {
    const angle = Math.atan(radius);
    const s = angle * angle;
    const slope = 1 + s * (3 * k[0] + s * (5 * k[1] + s * (7 * k[2] + s * 9 * k[3])));
    if (slope <= 0) return null;
    const bent = angle * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
    const stretch = radius > 0 ? bent / radius : 1;
    return [x * stretch, y * stretch];
  }
  const [k1, k2, p1, p2, k3, k4, k5, k6] = k;
  /** @param {number} r */
  const radial = (r) => {
    const s = r * r;
    return (r * (1 + s * (k1 + s * (k2 + s * k3)))) / (1 + s * (k4 + s * (k5 + s * k6)));
  };
  for (let step = 1, last = 0; step <= 24; step++) {
    const next = radial((radius * step) / 24);
    if (next <= last && radius > 0) return null;
    last = next;
  }
  const s = radius * radius;
  const stretch = radius > 0 ? radial(radius) / radius : 1;
  return [
    x * stretch + 2 * p1 * x * y + p2 * (s + 2 * x * x),
    y * stretch + p1 * (s + 2 * y * y) + 2 * p2 * x * y,
  ];
}
