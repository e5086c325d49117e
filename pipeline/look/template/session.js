// The sensors of a session: table, distances from the merged take, shares over time.

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

// The share of a sensor in each frame [%], over all joints.
function meanShare({ shares }) {
  return report.time.map((_, f) => {
    const here = shares.subarray(f * joints, (f + 1) * joints);
    return here.reduce((sum, share) => sum + share, 0) / joints;
  });
}

function addSession(go) {
  const parent = document.getElementById("session-maps"), sensors = report.sensors;
  fillSensors(document.getElementById("sensors"));
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
  const lines = sensors.map((s) => [s.name, meanShare(s), s.color]);
  added.push(addMap(parent, shares, go));
  added.push(addCurve(parent, { name: "Share of each sensor, %", lines, legend }, go));
  return added;
}
