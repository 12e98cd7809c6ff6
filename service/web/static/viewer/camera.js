// @ts-check
/** Orbit camera in the scene's odom space: x right, y down, z ahead of the viewer. */

/** @typedef {[number, number, number]} Place */
/** @typedef {ArrayLike<number>} Matrix Sixteen numbers, row by row. */

const FIELD_OF_VIEW = (50 * Math.PI) / 180;
const FOCAL = 0.5 / Math.tan(FIELD_OF_VIEW / 2);
export const NEAR_M = 0.3;
const LOWEST = -0.15;
const HIGHEST = Math.PI / 2 - 0.001;

export class Camera {
  /** @param {boolean} flat True for the view from above without perspective. */
  constructor(flat) {
    this.flat = flat;
    /** @type {Place} */
    this.target = [0, 0, 0];
    this.yaw = 0;
    this.pitch = flat ? Math.PI / 2 : 0.5;
    this.distance = 40;
  }

  /**
   * Turn around the target, radians.
   * @param {number} yaw
   * @param {number} pitch
   */
  turn(yaw, pitch) {
    this.yaw += yaw;
    if (!this.flat) this.pitch = Math.min(HIGHEST, Math.max(LOWEST, this.pitch + pitch));
  }

  /** @param {number} factor Above 1: farther away. */
  zoom(factor) {
    this.distance = Math.min(400, Math.max(2, this.distance * factor));
  }

  /**
   * Shift the target along the ground with the pointer.
   * @param {number} right Pixels.
   * @param {number} down Pixels.
   * @param {number} height Height of the view, pixels.
   */
  pan(right, down, height) {
    const scale = this.distance / (FOCAL * height);
    const along = (down * scale) / Math.max(0.35, Math.sin(this.pitch));
    const across = -right * scale;
    this.target[0] += Math.cos(this.yaw) * along + Math.sin(this.yaw) * across;
    this.target[1] += Math.sin(this.yaw) * along - Math.cos(this.yaw) * across;
  }

  /** Pixels of a metre at the target, for a view of this height. @param {number} height */
  pixelsPerMetre(height) {
    return (FOCAL * height) / this.distance;
  }

  /**
   * Return three rows of four numbers that map a place in metres to scaled right and down, and to
   * the distance ahead. In perspective right and down are divided by that distance.
   * @param {number} height Height of the view, pixels.
   */
  rows(height) {
    const [cy, sy, cp, sp] = [
      Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch),
    ];
    const axes = [[sy, -cy, 0], [-sp * cy, -sp * sy, -cp], [cp * cy, cp * sy, -sp]];
    const scale = this.flat ? this.pixelsPerMetre(height) : FOCAL * height;
    const [x, y, z] = this.target;
    return axes.map((axis, i) => {
      const by = i < 2 ? scale : 1;
      const offset = -(axis[0] * x + axis[1] * y + axis[2] * z) + (i < 2 ? 0 : this.distance);
      return [axis[0] * by, axis[1] * by, axis[2] * by, offset * by];
    });
  }
}

/**
 * Combine rows of a camera with the pose of a frame, for points in centimetres of sensor space.
 * @param {number[][]} rows
 * @param {Matrix} pose odom_from_sensor.
 * @returns {Float64Array} Twelve numbers, row by row.
 */
export function fromSensor(rows, pose) {
  const out = new Float64Array(12);
  rows.forEach((row, r) => {
    for (let c = 0; c < 4; c++) {
      let sum = row[0] * pose[c] + row[1] * pose[4 + c] + row[2] * pose[8 + c];
      if (c === 3) sum += row[3];
      out[4 * r + c] = c < 3 ? sum / 100 : sum;
    }
  });
  return out;
}

/**
 * Map a place by rows or by a pose.
 * @param {ArrayLike<number>[]} rows
 * @param {ArrayLike<number>} at
 * @returns {Place}
 */
export function apply(rows, at) {
  return /** @type {Place} */ (
    [0, 1, 2].map((r) => {
      const row = rows[r];
      return row[0] * at[0] + row[1] * at[1] + row[2] * at[2] + row[3];
    })
  );
}

/** Return the rows of a matrix of sixteen numbers. @param {Matrix} m */
export function rowsOf(m) {
  return [0, 4, 8].map((i) => [m[i], m[i + 1], m[i + 2], m[i + 3]]);
}
