// The raw and the clean figure, seen by a camera that the mouse turns.

const canvas = at("figures");
const TALL = report.height * 1000; // mm
const [lowest, highest] = report.bounds; // corners of a box around the whole clip [mm]
const spread = Math.max(highest[0] - lowest[0], highest[2] - lowest[2]);
const view = { yaw: report.facing + 0.35, pitch: 0.16, zoom: 1, over: false,
  follow: spread > 1.6 * TALL };

// The point in the middle of the picture [mm].
function middle(frame) {
  const root = 3 * (frame * joints + report.parents.indexOf(-1));
  const [x, z] = [0, 2].map((n) =>
    view.follow ? report.clean[root + n] : (lowest[n] + highest[n]) / 2);
  return [x, 0.5 * TALL, z];
}

const RAW = { width: 3, radius: 5, bone: () => "#8a8f99",
  joint: (k) => `rgb(${reliabilityColor(report.reliability[k])})` };
const CLEAN = { width: 6, radius: 3, joint: () => "#1d2330",
  bone: (k) => ORIGIN_COLORS[report.origin[k]] || UNKNOWN };

function drawContacts(context, points, frame) {
  [context.strokeStyle, context.lineWidth] = ["#17803a", 2.5];
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
  const { context, width, height } = stage(canvas);
  const center = middle(frame), half = width / 2, parents = report.parents;
  const shown = view.follow ? TALL : Math.max(TALL, 0.8 * spread);
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
    lettering(context, "left", "#1d2330", "600 15px");
    context.fillText(name, left + 14, 26);
    context.restore();
  }
}
