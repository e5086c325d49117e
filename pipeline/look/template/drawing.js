// What all pages share: figures of joints and bones on a floor, seen by one camera.

const MISSING = -32768;
const NUMBERS = { u1: Uint8Array, i2: Int16Array, f4: Float32Array, f8: Float64Array };
const at = (id) => document.getElementById(id);

// Reviver for JSON.parse: arrays of numbers are base64, by the name of their type.
function unpacked(_, value) {
  const kind = Object.keys(NUMBERS).find((name) => value?.[name] !== undefined);
  if (!kind) return value;
  const bytes = Uint8Array.from(atob(value[kind]), (c) => c.charCodeAt(0));
  return new NUMBERS[kind](bytes.buffer);
}

// Clears a canvas; returns its context in CSS pixels, sharp on any screen, and its size.
function stage(canvas) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  [canvas.width, canvas.height] = [Math.round(width * scale), Math.round(height * scale)];
  const context = canvas.getContext("2d");
  context.scale(scale, scale);
  return { context, width, height };
}

// Creates an element with text, which is never parsed as markup.
function element(kind, text = "", classes = "") {
  const node = document.createElement(kind);
  [node.textContent, node.className] = [text, classes];
  return node;
}

// The last frame at or before a time [s].
function frameAt(time, seconds) {
  let low = 0, high = time.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= seconds) low = middle;
    else high = middle - 1;
  }
  return low;
}

// Returns a function from a point [mm] to the canvas [px]. The camera looks from the
// sensor's side (from -z), turned by yaw and pitch, and fits a length `shown` [mm].
function projection({ yaw, pitch, zoom }, tall, shown, center, left, width, height) {
  const [cy, sy] = [Math.cos(yaw), Math.sin(yaw)];
  const [cp, sp] = [Math.cos(pitch), Math.sin(pitch)];
  const away = 3.2 * tall;
  const focal = (zoom * 0.85 * Math.min(height, width) * away) / shown;
  return (x, y, z) => {
    [x, y, z] = [x - center[0], y - center[1], z - center[2]];
    const right = -(x * cy + z * sy), far = z * cy - x * sy;
    const up = y * cp + far * sp;
    const depth = Math.max(away + far * cp - y * sp, 0.1 * away);
    return [left + width / 2 + (focal * right) / depth,
            height / 2 - (focal * up) / depth];
  };
}

// Strokes lines between pairs of points on the canvas [px].
function drawLines(context, pairs, color, width) {
  [context.strokeStyle, context.lineWidth] = [color, width];
  context.beginPath();
  for (const [start, end] of pairs) {
    context.moveTo(...start);
    context.lineTo(...end);
  }
  context.stroke();
}

function drawFloor(context, project, center, count = 4) {
  const step = 500, far = step * count, pairs = [];
  const [x, z] = [center[0], center[2]].map((v) => Math.round(v / step) * step);
  for (let k = -far; k <= far; k += step) {
    pairs.push([project(x + k, 0, z - far), project(x + k, 0, z + far)]);
    pairs.push([project(x - far, 0, z + k), project(x + far, 0, z + k)]);
  }
  drawLines(context, pairs, "#ccd2dc", 1);
}

function drawFigure(context, project, positions, parents, frame, look) {
  const first = frame * parents.length;
  const points = parents.map((_, j) => {
    const [x, y, z] = positions.subarray(3 * (first + j));
    return x === MISSING ? null : project(x, y, z);
  });
  context.lineCap = "round";
  parents.forEach((parent, j) => {
    if (parent < 0 || !points[j] || !points[parent]) return;
    drawLines(context, [[points[parent], points[j]]], look.bone(first + j), look.width);
  });
  points.forEach((point, j) => {
    if (!point) return;
    context.fillStyle = look.joint(first + j);
    context.beginPath();
    context.arc(...point, look.radius, 0, 7);
    context.fill();
  });
  return points;
}

// Turns a camera when the mouse drags on a canvas, and zooms with its wheel.
function turnByMouse(canvas, view, redraw) {
  canvas.addEventListener("pointerdown", (e) => canvas.setPointerCapture(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    if (!e.buttons) return;
    view.yaw -= e.movementX * 0.008;
    view.pitch = Math.min(1.5, Math.max(-0.2, view.pitch + e.movementY * 0.008));
    redraw();
  });
  canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    view.zoom = Math.min(6, Math.max(0.3, view.zoom * Math.exp(-e.deltaY * 0.001)));
    redraw();
  }, { passive: false });
}
