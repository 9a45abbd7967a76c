// Mouse, touch and keyboard over the picture: one pointer turns the view, two or the wheel move it nearer.

const TURN = 0.008; // rad a pixel
const KEY_TURN = 0.08; // rad a key
const KEY_ZOOM = 0.92;
const WHEEL = 0.001; // of the logarithm of the distance, a pixel
const KEYS = {
  ArrowLeft: [KEY_TURN, 0], ArrowRight: [-KEY_TURN, 0], ArrowUp: [0, -KEY_TURN], ArrowDown: [0, KEY_TURN],
};

export function listenToGestures(canvas, orbit, changed) {
  const pointers = new Map();
  const act = (action) => {
    action();
    changed();
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) return;
    const before = [...pointers.values()];
    const [x, y] = pointers.get(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (pointers.size === 1) act(() => orbit.turn((x - event.clientX) * TURN, (event.clientY - y) * TURN));
    else if (pointers.size === 2) act(() => orbit.zoom(apart(before) / apart([...pointers.values()])));
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    act(() => orbit.zoom(Math.exp(event.deltaY * WHEEL)));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const action = keyAction(event.key, orbit);
    if (!action) return;
    event.preventDefault();
    act(action);
  });
}

function keyAction(key, orbit) {
  if (KEYS[key]) return () => orbit.turn(...KEYS[key]);
  if (key === "+" || key === "=") return () => orbit.zoom(KEY_ZOOM);
  if (key === "-") return () => orbit.zoom(1 / KEY_ZOOM);
  return key === "Home" ? () => orbit.reset() : null;
}

function apart([[ax, ay], [bx, by]]) {
  return Math.max(Math.hypot(ax - bx, ay - by), 1);
}
