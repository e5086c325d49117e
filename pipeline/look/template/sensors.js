// What each sensor of a session saw, and where it stands in the room.

const room = document.getElementById("room");
document.getElementById("session").hidden = !report.sensors.length;

// The room from above, from the side of most sensors; its corners, its middle and size [mm].
const roomView = { zoom: 1, pitch: 0.5 };
const roomPoints = report.sensors.flatMap((sensor) => sensor.edges.flat());
const person = [];
for (let f = 0; f < frames; f += Math.ceil(frames / 500)) {
  const [x, , z] = report.clean.subarray(3 * f * joints, 3 * f * joints + 3);
  person.push([x, 0, z], [x, report.height * 1000, z]);
}
roomPoints.push(...person);
const [roomMiddle, roomSize] = (() => {
  const [low, high] = [Math.min, Math.max].map((end) => [0, 1, 2].map((n) =>
    roomPoints.reduce((found, point) => end(found, point[n]), roomPoints[0][n])));
  const middle = low.map((value, n) => (value + high[n]) / 2);
  const mean = (points, n) => points.reduce((sum, p) => sum + p[n], 0) / points.length;
  const eyes = report.sensors.map((sensor) => sensor.edges[0][0]);
  const away = (n) => mean(eyes, n) - mean(person, n);
  roomView.yaw = Math.atan2(away(0), -away(2));
  return [middle, Math.hypot(...low.map((value, n) => high[n] - value))];
})();
const roomStart = { ...roomView };

// A function from a point [mm] to the canvas [px]: all of the room is seen at the start.
function roomProjection(width, height) {
  const made = (view) => projection(view, roomSize, roomSize, roomMiddle, 0, width, height);
  const start = made(roomStart), found = made(roomView), seen = roomPoints.map((p) => start(...p));
  const [x, y] = [0, 1].map((n) => {
    const values = seen.map((p) => p[n]);
    const [low, high] = [Math.min, Math.max].map((end) => values.reduce((a, b) => end(a, b)));
    return { middle: (low + high) / 2, size: high - low };
  });
  const scale = Math.min((0.8 * width) / x.size, (0.8 * height) / y.size);
  return (...point) => {
    const [right, down] = found(...point);
    return [width / 2 + scale * (right - x.middle), height / 2 + scale * (down - y.middle)];
  };
}

const MERGED = { width: 7, radius: 3, bone: () => "#b4bac4", joint: () => "#b4bac4" };
const thin = ({ color }) => ({ width: 2, radius: 3.5, bone: () => color, joint: () => color });

function drawSensorFigures(context, project, frame) {
  for (const sensor of report.sensors) {
    drawFigure(context, project, sensor.joints, report.parents, frame, thin(sensor));
  }
}

function drawRoom(frame) {
  const { context, width, height } = sharp(room);
  context.fillStyle = "#eef1f5";
  context.fillRect(0, 0, width, height);
  const project = roomProjection(width, height);
  drawFloor(context, project, roomMiddle, Math.ceil(roomSize / 1000));
  drawFigure(context, project, report.raw, report.parents, frame, MERGED);
  drawSensorFigures(context, project, frame);
  context.font = "600 13px system-ui, 'DejaVu Sans', sans-serif";
  context.textAlign = "center";
  context.lineWidth = 2;
  const rows = []; // of names, each under those before that it would cover
  for (const { name, color, edges } of report.sensors) {
    context.strokeStyle = context.fillStyle = color;
    context.beginPath();
    for (const [start, end] of edges) {
      context.moveTo(...project(...start));
      context.lineTo(...project(...end));
    }
    context.stroke();
    const wide = context.measureText(name).width;
    let [x, y] = project(...edges.at(-1)[1]);
    [x, y] = [Math.min(Math.max(x, wide / 2 + 6), width - wide / 2 - 6), y + 16];
    while (rows.some((k) => Math.abs(k.x - x) < (k.wide + wide) / 2 && Math.abs(k.y - y) < 16)) {
      y += 4;
    }
    rows.push({ x, y, wide });
    context.fillText(name, x, y);
  }
}
