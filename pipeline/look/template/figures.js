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
  const center = middle(frame), half = width / 2, parents = report.parents;
  const shown = view.follow ? TALL : Math.max(TALL, 0.8 * bounds.wide);
  const panes = view.over
    ? [["raw over clean", 0, width, true, true]]
    : [["raw", 0, half, true, false], ["clean", half, half, false, true]];
  for (const [name, left, wide, raw, clean] of panes) {
    context.save();
    context.beginPath();
    context.rect(left, 0, wide, height);
    context.clip();
    const project = projection(view, TALL, shown, center, left, wide, height);
    drawFloor(context, project, center);
    if (clean) {
      const points = drawFigure(context, project, report.clean, parents, frame, CLEAN);
      drawContacts(context, points, frame);
    }
    if (raw) {
      drawFigure(context, project, report.raw, parents, frame, RAW);
      drawSensorFigures(context, project, frame);
    }
    context.fillStyle = "#1d2330";
    context.font = "600 15px system-ui, 'DejaVu Sans', sans-serif";
    context.fillText(name, left + 14, 26);
    context.restore();
  }
}
