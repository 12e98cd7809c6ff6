// @ts-check
/** Rasteriser: points of a frame into pixels with a depth buffer, in typed arrays alone. */

import { NEAR_M } from "./camera.js";
import { NO_POSITION_CM } from "./codec.js";

/** Pixels and depths of a view; it grows with the view. */
export class Surface {
  constructor() {
    this.width = 1;
    this.height = 1;
    this.image = new ImageData(1, 1);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.depths = new Float32Array(1);
  }

  /**
   * @param {number} width
   * @param {number} height
   */
  resize(width, height) {
    if (width === this.width && height === this.height) return;
    this.width = width;
    this.height = height;
    this.image = new ImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.depths = new Float32Array(width * height);
  }

  /** @param {number} background Colour as a pixel. */
  clear(background) {
    this.pixels.fill(background);
    this.depths.fill(Infinity);
  }

  /**
   * Draw points as squares; the nearest one of a pixel is kept.
   * @param {Int16Array} points Four numbers a point, see `codec.js`.
   * @param {Float64Array} m Rows of `fromSensor`.
   * @param {boolean} flat True without perspective.
   * @param {{colours: Uint32Array, sizes: Uint8Array}} table Colour 0: not drawn.
   * @param {number} ratio Pixels of the device per pixel of the page.
   */
  draw(points, m, flat, table, ratio) {
    const { width, height, pixels, depths } = this;
    const { colours, sizes } = table;
    const [a, b, c, d, e, f, g, h, i, j, k, l] = m;
    const [midX, midY] = [width / 2, height / 2];
    const [near, close] = [9, 22];
    for (let at = 0; at < points.length; at += 4) {
      const x = points[at];
      if (x === NO_POSITION_CM) continue;
      const code = points[at + 3] & 0x7fff;
      const colour = colours[code];
      if (colour === 0) continue;
      const y = points[at + 1];
      const z = points[at + 2];
      const depth = i * x + j * y + k * z + l;
      let u = a * x + b * y + c * z + d;
      let v = e * x + f * y + g * z + h;
      let size = sizes[code] * ratio;
      if (!flat) {
        if (depth < NEAR_M) continue;
        u /= depth;
        v /= depth;
        if (depth < close) size += depth < near ? 2 * ratio : ratio;
      }
      size = size < 1 ? 1 : size | 0;
      const left = (u + midX - size / 2) | 0;
      const top = (v + midY - size / 2) | 0;
      if (left < 0 || top < 0 || left + size > width || top + size > height) continue;
      let row = top * width + left;
      for (let dy = 0; dy < size; dy++, row += width) {
        for (let to = row; to < row + size; to++) {
          if (depth < depths[to]) {
            depths[to] = depth;
            pixels[to] = colour;
          }
        }
      }
    }
  }
}
