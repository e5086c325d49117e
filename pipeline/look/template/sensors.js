// The sensors of a session: where they stand in the room, what each saw, and how far that
// is from the merged take.

const room = at("room");
at("session").hidden = !report.sensors.length;

// The middle and the size of a box around points, along each axis.
function extent(points) {
  const [low, high] = [Math.min, Math.max].map((end) =>
    points.reduce((found, point) => found.map((value, n) => end(value, point[n]))));
  return { middle: low.map((value, n) => (value + high[n]) / 2),
           size: low.map((value, n) => high[n] - value) };
}

// The room from above, from the side of most sensors: these, and a box around the clip.
const person = [lowest, highest].flatMap(([x]) =>
  [lowest, highest].flatMap(([, , z]) => [[x, 0, z], [x, TALL, z]]));
const roomPoints = [...person, ...report.sensors.flatMap((sensor) => sensor.edges.flat())];
const roomBox = extent(roomPoints), roomSize = Math.hypot(...roomBox.size);
const [aside, , before] = extent(person).middle.map((value, n) => report.sensors.reduce(
  (sum, { edges }) => sum + edges[0][0][n] - value, 0));
const roomView = { zoom: 1, pitch: 0.5, yaw: Math.atan2(aside, -before) };
const roomStart = { ...roomView };

// A function from a point [mm] to the canvas [px]: all of the room is seen at the start.
function roomProjection(width, height) {
  const made = (view) =>
    projection(view, roomSize, roomSize, roomBox.middle, 0, width, height);
  const start = made(roomStart), found = made(roomView);
  const { middle, size } = extent(roomPoints.map((point) => start(...point)));
  const scale = Math.min((0.8 * width) / size[0], (0.8 * height) / size[1]);
  return (...point) => {
    const [right, down] = found(...point);
    return [width / 2 + scale * (right - middle[0]),
            height / 2 + scale * (down - middle[1])];
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
  const { context, width, height } = stage(room);
  const project = roomProjection(width, height);
  drawFloor(context, project, roomBox.middle, Math.ceil(roomSize / 1000));
  drawFigure(context, project, report.raw, report.parents, frame, MERGED);
  drawSensorFigures(context, project, frame);
  context.lineWidth = 2;
  const rows = []; // of names, each under those before that it would cover
  for (const { name, color, edges } of report.sensors) {
    context.strokeStyle = color;
    context.beginPath();
    for (const [start, end] of edges) {
      context.moveTo(...project(...start));
      context.lineTo(...project(...end));
    }
    context.stroke();
    lettering(context, "center", color, "600 13px");
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

function fillSensors(table) {
  addRow(table, "th", [["sensor", "text"], ["lag, s"], ["drift, ms a minute"],
    ["turned, degrees"], ["from the first, m"], ["share"], ["apart, cm"]]);
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
  const said = (k) => sensors.map((s) =>
    `${s.name}: ${cm(s.residuals[k])} apart, share ${s.shares[k]}%`).join("\n");
  const legend = sensors.map((s) => [s.color, s.name]);
  const added = sensors.map((s) => addMap(parent,
    distanceMap(`Distance of ${s.name} from the merged take`, s.residuals, s.color, 200, said),
    go));
  const shares = {
    title: "Which sensor a joint is of", rows: report.joints, tip: said, legend,
    badness: () => 0,
    color: (k) => {
      const whole = sensors.reduce((sum, s) => sum + s.shares[k], 0);
      return whole ? [0, 1, 2].map((n) => Math.round(sensors.reduce(
        (sum, s) => sum + (s.shares[k] * rgb(s.color)[n]) / whole, 0))) : [120, 120, 128];
    },
  };
  const lines = sensors.map((s) => [s.name, s.share, s.color]);
  added.push(addMap(parent, shares, go));
  added.push(addCurve(parent, { name: "Share of each sensor, %", lines, legend }, go));
  return added;
}
