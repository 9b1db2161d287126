// Hands on the map: drag and pinch, wheel, keys. It only moves the camera and says that somebody did.
//
// On a phone the map fills the screen: one finger up or down scrolls the page (`touch-action: pan-y`), two move the map.

const ZOOM_STEP = 1.25;
const PAN_STEP_PX = 40;
// A pointer that moves less than this between down and up is a click.
const CLICK_PX = 5;

const KEYS = new Map([
  ['ArrowLeft', (camera) => camera.pan(PAN_STEP_PX, 0)],
  ['ArrowRight', (camera) => camera.pan(-PAN_STEP_PX, 0)],
  ['ArrowUp', (camera) => camera.pan(0, PAN_STEP_PX)],
  ['ArrowDown', (camera) => camera.pan(0, -PAN_STEP_PX)],
  ['+', (camera) => camera.zoom(ZOOM_STEP)],
  ['=', (camera) => camera.zoom(ZOOM_STEP)],
  ['-', (camera) => camera.zoom(1 / ZOOM_STEP)],
]);

/** Listens on a canvas; calls `onMove` after each change of the camera, and `onClick(x_px, y_px)` where nothing was moved. */
export function listen(canvas, camera, onMove, onClick) {
  const pointers = new Map();
  listenForClicks(canvas, onClick);
  canvas.addEventListener('pointerdown', (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, point(event));
  });
  canvas.addEventListener('pointermove', (event) => {
    if (!pointers.has(event.pointerId)) return;
    const before = gesture(pointers);
    pointers.set(event.pointerId, point(event));
    const after = gesture(pointers);
    camera.pan(after.x_px - before.x_px, after.y_px - before.y_px);
    if (before.spread_px > 0 && after.spread_px > 0) camera.zoom(after.spread_px / before.spread_px, after.x_px, after.y_px);
    onMove();
  });
  for (const name of ['pointerup', 'pointercancel']) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  for (const name of ['touchstart', 'touchmove']) {
    canvas.addEventListener(name, (event) => { if (event.touches.length > 1) event.preventDefault(); }, { passive: false });
  }
  canvas.addEventListener('wheel', (event) => wheel(event, camera, onMove), { passive: false });
  canvas.addEventListener('keydown', (event) => key(event, camera, onMove));
}

function listenForClicks(canvas, onClick) {
  let down = null;
  canvas.addEventListener('pointerdown', (event) => { down = event.isPrimary && event.button === 0 ? point(event) : null; });
  canvas.addEventListener('pointerup', (event) => {
    if (down && event.isPrimary && Math.hypot(event.offsetX - down.x_px, event.offsetY - down.y_px) < CLICK_PX) onClick(event.offsetX, event.offsetY);
    down = null;
  });
}

function point(event) {
  return { x_px: event.offsetX, y_px: event.offsetY };
}

// Middle of the fingers and how far apart the first two are.
function gesture(pointers) {
  const [first, second] = pointers.values();
  if (!second) return { ...first, spread_px: 0 };
  return {
    x_px: (first.x_px + second.x_px) / 2,
    y_px: (first.y_px + second.y_px) / 2,
    spread_px: Math.hypot(first.x_px - second.x_px, first.y_px - second.y_px),
  };
}

function wheel(event, camera, onMove) {
  event.preventDefault();
  camera.zoom(Math.exp(-0.0015 * event.deltaY), event.offsetX, event.offsetY);
  onMove();
}

function key(event, camera, onMove) {
  const act = KEYS.get(event.key);
  if (!act || event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  act(camera);
  onMove();
}
