// What pages draw: figures of joints and bones on a floor, seen by one camera.

const MISSING = -32768;
const NUMBERS = { u1: Uint8Array, i2: Int16Array, f4: Float32Array, f8: Float64Array };
const at = (id) => document.getElementById(id);

// For JSON.parse: arrays of numbers are base64 under the name of their type.
function unpacked(_, value) {
  const kind = Object.keys(NUMBERS).find((name) => value?.[name] !== undefined);
  if (!kind) return value;
  const bytes = Uint8Array.from(atob(value[kind]), (c) => c.charCodeAt(0));
  return new NUMBERS[kind](bytes.buffer);
}

// A canvas's context in CSS pixels, sharp on any screen, and its size.
function sharp(canvas) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  return { context, width, height };
}

// The same, for figures.
function stage(canvas) {
  const sized = sharp(canvas);
  sized.context.fillStyle = "#eef1f5";
  sized.context.fillRect(0, 0, sized.width, sized.height);
  return sized;
}

// An element with text, which is never markup.
function element(kind, text = "", classes = "") {
  const made = document.createElement(kind);
  made.textContent = text;
  made.className = classes;
  return made;
}

// The last frame at or before some seconds.
function frameAt(time, seconds) {
  let low = 0, high = time.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= seconds) low = middle;
    else high = middle - 1;
  }
  return low;
}

// A function from a point [mm] to the canvas [px]: the camera sees it from the sensor's
// side (from -z), turned by yaw and pitch, so that as much as is shown [mm] fits.
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

function drawFloor(context, project, center, count = 4) {
  const step = 500;
  const [x, z] = [center[0], center[2]].map((v) => Math.round(v / step) * step);
  const far = step * count;
  context.strokeStyle = "#ccd2dc";
  context.lineWidth = 1;
  context.beginPath();
  for (let k = -far; k <= far; k += step) {
    for (const [a, b] of [[[x + k, z - far], [x + k, z + far]],
                          [[x - far, z + k], [x + far, z + k]]]) {
      context.moveTo(...project(a[0], 0, a[1]));
      context.lineTo(...project(b[0], 0, b[1]));
    }
  }
  context.stroke();
}

function drawFigure(context, project, positions, parents, frame, look) {
  const points = [], joints = parents.length;
  for (let j = 0; j < joints; j++) {
    const k = 3 * (frame * joints + j);
    points.push(positions[k] === MISSING
      ? null : project(positions[k], positions[k + 1], positions[k + 2]));
  }
  context.lineCap = "round";
  parents.forEach((parent, j) => {
    if (parent < 0 || !points[j] || !points[parent]) return;
    context.strokeStyle = look.bone(frame * joints + j);
    context.lineWidth = look.width;
    context.beginPath();
    context.moveTo(...points[parent]);
    context.lineTo(...points[j]);
    context.stroke();
  });
  points.forEach((point, j) => {
    if (!point) return;
    context.fillStyle = look.joint(frame * joints + j);
    context.beginPath();
    context.arc(...point, look.radius, 0, 7);
    context.fill();
  });
  return points;
}

// Lets the mouse turn a camera by dragging a canvas, and zoom by its wheel.
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
