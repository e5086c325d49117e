// The sensors of a session: where they are in the room, what each saw, and how far that
// is from the merged take.

const room = at("room");
at("session").hidden = !report.sensors.length;

// The middle and the size of a box around points, along each axis.
function extent(points) {
  const [low, high] = [Math.min, Math.max].map((end) =>
    points.reduce((bound, point) => bound.map((value, n) => end(value, point[n]))));
  return { middle: low.map((value, n) => (value + high[n]) / 2),
           size: low.map((value, n) => high[n] - value) };
}

// The camera looks down at the sensors and a box around the clip, from most sensors' side.
const person = [lowest, highest].flatMap(([x]) =>
  [lowest, highest].flatMap(([, , z]) => [[x, 0, z], [x, TALL, z]]));
const roomPoints = [...person, ...report.sensors.flatMap((sensor) => sensor.edges.flat())];
const roomBox = extent(roomPoints), roomSize = Math.hypot(...roomBox.size);
const [aside, , before] = extent(person).middle.map((value, n) => report.sensors.reduce(
  (sum, { edges }) => sum + edges[0][0][n] - value, 0));
const roomView = { zoom: 1, pitch: 0.5, yaw: Math.atan2(aside, -before) };
const roomStart = { ...roomView };

// Returns a function from a point [mm] to the canvas [px]; at first it shows everything.
function roomProjection(width, height) {
  const [start, now] = [roomStart, roomView].map((view) =>
    projection(view, roomSize, roomSize, roomBox.middle, 0, width, height));
  const { middle, size } = extent(roomPoints.map((point) => start(...point)));
  const scale = Math.min((0.8 * width) / size[0], (0.8 * height) / size[1]);
  return (...point) => {
    const [right, down] = now(...point);
    return [width / 2 + scale * (right - middle[0]),
            height / 2 + scale * (down - middle[1])];
  };
}

const oneColor = (color, width, radius) =>
  ({ width, radius, bone: () => color, joint: () => color });

function drawSensorFigures(context, project, frame) {
  for (const { joints, color } of report.sensors) {
    drawFigure(context, project, joints, report.parents, frame, oneColor(color, 2, 3.5));
  }
}

function drawRoom(frame) {
  const { context, width, height } = stage(room);
  const project = roomProjection(width, height);
  drawFloor(context, project, roomBox.middle, Math.ceil(roomSize / 1000));
  drawFigure(context, project, report.raw, report.parents, frame, oneColor("#b4bac4", 7, 3));
  drawSensorFigures(context, project, frame);
  const names = []; // already drawn, which the next one must not cover
  for (const { name, color, edges } of report.sensors) {
    const lines = edges.map((ends) => ends.map((point) => project(...point)));
    drawLines(context, lines, color, 2);
    lettering(context, "center", color, "600 13px");
    const wide = context.measureText(name).width;
    let [x, y] = lines.at(-1)[1];
    [x, y] = [Math.min(Math.max(x, wide / 2 + 6), width - wide / 2 - 6), y + 16];
    while (names.some((k) => Math.abs(k.x - x) < (k.wide + wide) / 2 && Math.abs(k.y - y) < 16)) {
      y += 4;
    }
    names.push({ x, y, wide });
    context.fillText(name, x, y);
  }
}

function fillSensors(table) {
  addRow(table, "th", [["sensor", "text"], ["lag, s"], ["clock drift, ms/min"],
    ["rotation, degrees"], ["distance to sensor 1, m"], ["share"], ["off by, cm"]]);
  for (const { name, color, figures } of report.sensors) {
    const row = addRow(table, "td", [[name, "text"], [figures.lag_seconds.toFixed(3)],
      [(60e3 * figures.drift).toFixed(1)], [figures.turned_degrees.toFixed(1)],
      [figures.away_meters.toFixed(2)], [`${Math.round(100 * figures.share)}%`],
      [figures.apart_meters === null ? "–" : (100 * figures.apart_meters).toFixed(1)]]);
    row.firstChild.style.color = color;
  }
}

function addSession(go) {
  const parent = at("session-maps"), sensors = report.sensors;
  fillSensors(at("sensors"));
  const tip = (k) => sensors.map((s) =>
    `${s.name}: ${cm(s.residuals[k])} from merged, share ${s.shares[k]}%`).join("\n");
  const legend = sensors.map((s) => [s.color, s.name]);
  const distances = sensors.map((s) => distanceMap(
    `Distance of ${s.name} from the merged take`, s.residuals, s.color, 200, tip));
  const shares = {
    title: "Share of the sensors in each joint", rows: report.joints, tip, legend,
    badness: () => 0,
    color: (k) => {
      const whole = sensors.reduce((sum, s) => sum + s.shares[k], 0);
      return whole ? [0, 1, 2].map((n) => Math.round(sensors.reduce(
        (sum, s) => sum + (s.shares[k] * rgb(s.color)[n]) / whole, 0))) : [120, 120, 128];
    },
  };
  const lines = sensors.map((s) => [s.name, s.share, s.color]);
  return [...[...distances, shares].map((map) => addMap(parent, map, go)),
    addCurve(parent, { name: "Share of each sensor, %", lines, legend }, go)];
}
