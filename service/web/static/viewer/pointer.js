// @ts-check
/** Pointer and touch on a pane: turn, pan, zoom, pinch, and a click on a track. */

/** @typedef {import("./viewer.js").Viewer} Viewer */

const TURN = 0.006;
const CLICK_PX = 4;

/**
 * Make a pane react to pointers.
 * @param {HTMLCanvasElement} canvas
 * @param {Viewer} viewer
 * @param {number} pane
 * @param {(x: number, y: number) => void} onClick
 */
export function listen(canvas, viewer, pane, onClick) {
  /** @type {Map<number, {x: number, y: number}>} */
  const down = new Map();
  let moved = 0;
  const panning = (/** @type {PointerEvent} */ event) =>
    event.buttons === 2 || event.buttons === 4 || event.shiftKey || event.ctrlKey;

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    if (down.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = down.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.offsetX - last.x, event.offsetY - last.y];
    moved += Math.abs(dx) + Math.abs(dy);
    const { camera } = viewer.panes[pane];
    if (down.size === 2) {
      const other = [...down.entries()].find(([id]) => id !== event.pointerId)?.[1] ?? last;
      const before = Math.hypot(last.x - other.x, last.y - other.y);
      const after = Math.hypot(event.offsetX - other.x, event.offsetY - other.y);
      if (after > 1) camera.zoom(before / after);
      camera.pan(dx / 2, dy / 2, canvas.clientHeight);
    } else if (panning(event) || camera.flat) {
      camera.pan(dx, dy, canvas.clientHeight);
    } else {
      camera.turn(-dx * TURN, dy * TURN);
    }
    down.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    viewer.draw();
  });
  const up = (/** @type {PointerEvent} */ event) => {
    if (down.delete(event.pointerId) && moved < CLICK_PX) onClick(event.offsetX, event.offsetY);
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", (event) => down.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      viewer.zoom(Math.exp(event.deltaY * (event.deltaMode ? 0.04 : 0.0014)), pane);
    },
    { passive: false },
  );
}
