// @ts-check
/** Decoder of the view block of one frame: byte planes to coordinates and codes. */

/** Coordinate of a point without a return. */
export const NO_POSITION_CM = -32768;

/** Label of a point that a source leaves unknown. */
export const UNKNOWN = 15;

/** Bits of a point's code above both labels (8 bits) and the witness label (4 bits). */
export const GROUND = 1 << 12;
export const OF_TRACK = 1 << 13;
export const SELECTED = 1 << 14;
export const CODES = 1 << 15;

const ZSTD_MAGIC = [0x28, 0xb5, 0x2f, 0xfd];

/** True for a block that the browser did not decompress. @param {Uint8Array} bytes */
export function isCompressed(bytes) {
  return ZSTD_MAGIC.every((value, i) => bytes[i] === value);
}

/**
 * A decoded frame.
 * @typedef {object} Frame
 * @property {number} count Number of points.
 * @property {Int16Array} points x, y, z in centimetres and the code of each point, in turn.
 * @property {Uint32Array} members Points that belong to an instance.
 * @property {Uint32Array} owners The instance of each of them.
 */

/**
 * Decode a view block that is no longer compressed.
 * @param {Uint8Array} bytes
 * @param {number} count Number of points of the frame.
 * @returns {Frame}
 */
export function decodeView(bytes, count) {
  const labelsAt = 6 * count;
  const witnessAt = labelsAt + 2 * count;
  const groundAt = witnessAt + count;
  const listAt = groundAt + ((count + 7) >> 3);
  if (bytes.length < listAt + 4) throw new Error("The block of this frame is cut short.");
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const listed = view.getUint32(listAt, true);
  if (bytes.length !== listAt + 4 + 8 * listed) {
    throw new Error("The block of this frame has another length than its points need.");
  }
  const points = new Int16Array(4 * count);
  for (let axis = 0; axis < 3; axis++) {
    const low = 2 * axis * count;
    const high = low + count;
    let value = 0;
    for (let i = 0, to = axis; i < count; i++, to += 4) {
      const folded = bytes[low + i] | (bytes[high + i] << 8);
      value = ((value + ((folded >>> 1) ^ -(folded & 1))) << 16) >> 16;
      points[to] = value;
    }
  }
  for (let i = 0, to = 3; i < count; i++, to += 4) {
    const ground = (bytes[groundAt + (i >> 3)] >> (7 - (i & 7))) & 1;
    points[to] = bytes[labelsAt + i] | ((bytes[witnessAt + i] & 15) << 8) | (ground ? GROUND : 0);
  }
  const members = new Uint32Array(listed);
  const owners = new Uint32Array(listed);
  for (let i = 0; i < listed; i++) {
    members[i] = view.getUint32(listAt + 4 + 4 * i, true);
    owners[i] = view.getUint32(listAt + 4 + 4 * (listed + i), true);
    if (members[i] >= count) throw new Error("The block of this frame names a point it lacks.");
  }
  return { count, points, members, owners };
}
