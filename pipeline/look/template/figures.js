// The raw and the clean figure, seen from a camera that the mouse turns.

const canvas = document.getElementById("figures");
const view = { yaw: facing() + 0.35, pitch: 0.16, zoom: 1, over: false, follow: false };
// The yaw [rad] that looks into the figure's face, over the clip.
function facing() {
  const [left, right] = ["Left", "Right"].map((s) => report.joints.indexOf(`Shoulder${s}`));
  let x = 0, z = 0;
  for (let f = 0; f < frames; f++) {
    const [a, b] = [3 * (f * joints + left), 3 * (f * joints + right)];
    x += report.clean[a] - report.clean[b];
    z += report.clean[a + 2] - report.clean[b + 2];
  }
  return Math.atan2(-z, -x);
}

const TALL = report.height * 1000; // mm

const bounds = (() => {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  for (let k = 0; k < frames * joints; k++) {
    for (const [n, axis] of [[0, 0], [1, 2]]) {
      low[n] = Math.min(low[n], report.clean[3 * k + axis]);
      high[n] = Math.max(high[n], report.clean[3 * k + axis]);
    }
  }
  return { low, high, wide: Math.max(high[0] - low[0], high[1] - low[1]) };
})();
view.follow = bounds.wide > 1.6 * TALL;

function middle(frame) {
  const height = 0.5 * TALL;
  if (!view.follow) {
    const { low, high } = bounds;
    return [(low[0] + high[0]) / 2, height, (low[1] + high[1]) / 2];
  }
  const root = 3 * (frame * joints + report.parents.indexOf(-1));
  return [report.clean[root], height, report.clean[root + 2]];
}

// A function from a point [mm] to the canvas [px]: the camera sees it from the sensor's
// side (from -z), turned by yaw and pitch.
function projection(center, left, width, height) {
  const [cy, sy] = [Math.cos(view.yaw), Math.sin(view.yaw)];
  const [cp, sp] = [Math.cos(view.pitch), Math.sin(view.pitch)];
  const away = 3.2 * TALL;
  const shown = view.follow ? TALL : Math.max(TALL, 0.8 * bounds.wide);
  const focal = (view.zoom * 0.85 * Math.min(height, width) * away) / shown;
  return (x, y, z) => {
    [x, y, z] = [x - center[0], y - center[1], z - center[2]];
    const right = -(x * cy + z * sy), far = z * cy - x * sy;
    const up = y * cp + far * sp;
    const depth = Math.max(away + far * cp - y * sp, 0.1 * away);
    return [left + width / 2 + (focal * right) / depth,
            height / 2 - (focal * up) / depth];
  };
}

function drawFloor(context, project, center) {
  const step = 500, count = 4;
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

function drawFigure(context, project, positions, frame, look) {
  const points = [];
  for (let j = 0; j < joints; j++) {
    const k = 3 * (frame * joints + j);
    points.push(positions[k] === MISSING
      ? null : project(positions[k], positions[k + 1], positions[k + 2]));
  }
  context.lineCap = "round";
  report.parents.forEach((parent, j) => {
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

const RAW = { width: 3, radius: 5, bone: () => "#8a8f99",
  joint: (k) => `rgb(${reliabilityColor(report.reliability[k])})` };
const CLEAN = { width: 6, radius: 3, joint: () => "#1d2330",
  bone: (k) => ORIGIN_COLORS[report.origin[k]] || UNKNOWN };

function drawContacts(context, points, frame) {
  context.strokeStyle = "#17803a";
  context.lineWidth = 2.5;
  report.parts.forEach((part, n) => {
    const name = part.replace("Heel", "Ankle").replace("Toe", "Foot");
    const point = points[report.joints.indexOf(name)];
    if (!point || !report.contacts[frame * report.parts.length + n]) return;
    context.beginPath();
    context.ellipse(...point, 11, 6, 0, 0, 7);
    context.stroke();
  });
}

function drawFigures(frame) {
  const { context, width, height } = sharp(canvas);
  context.fillStyle = "#eef1f5";
  context.fillRect(0, 0, width, height);
  const center = middle(frame), half = width / 2;
  const panes = view.over
    ? [["raw over clean", 0, width, true, true]]
    : [["raw", 0, half, true, false], ["clean", half, half, false, true]];
  for (const [name, left, wide, raw, clean] of panes) {
    context.save();
    context.beginPath();
    context.rect(left, 0, wide, height);
    context.clip();
    const project = projection(center, left, wide, height);
    drawFloor(context, project, center);
    if (clean) {
      const points = drawFigure(context, project, report.clean, frame, CLEAN);
      drawContacts(context, points, frame);
    }
    if (raw) drawFigure(context, project, report.raw, frame, RAW);
    context.fillStyle = "#1d2330";
    context.font = "600 15px system-ui, 'DejaVu Sans', sans-serif";
    context.fillText(name, left + 14, 26);
    context.restore();
  }
}

function turnByMouse(redraw) {
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
