// @ts-check
/** Worker that decompresses and decodes view blocks, so that the page never waits for it. */

import { decodeView, isCompressed } from "./codec.js";

/** Loaded only where the browser did not decompress; a constant, which type checkers pass over. */
const DECOMPRESSOR = "../vendor/fzstd.mjs";

/**
 * Decompress bytes that the browser did not decompress itself.
 * @param {Uint8Array} bytes
 */
async function plain(bytes) {
  if (!isCompressed(bytes)) return bytes;
  const { decompress } = await import(DECOMPRESSOR);
  return decompress(bytes);
}

addEventListener("message", async (event) => {
  const { index, buffer, count } = event.data;
  try {
    const frame = decodeView(await plain(new Uint8Array(buffer)), count);
    const moved = [frame.points.buffer, frame.members.buffer, frame.owners.buffer];
    /** @type {any} */ (self).postMessage({ index, frame }, moved);
  } catch (error) {
    /** @type {any} */ (self).postMessage({ index, problem: String(error) });
  }
});

/** @type {any} */ (self).postMessage({ ready: true });
