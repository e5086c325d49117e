// The data of the page, its arrays unpacked.

const report = JSON.parse(document.getElementById("data").textContent);
for (const [Numbers, names] of [
  [Float64Array, ["time"]],
  [Int16Array, ["raw", "clean", "correction", "physics", "uncertainty"]],
  [Uint8Array, ["reliability", "term", "origin", "contacts"]],
]) {
  for (const name of names) report[name] = unpacked(report[name], Numbers);
}
for (const curve of report.curves) {
  curve.raw = unpacked(curve.raw, Float32Array);
  curve.clean = unpacked(curve.clean, Float32Array);
}
for (const sensor of report.sensors) {
  for (const name of ["joints", "residuals"]) sensor[name] = unpacked(sensor[name], Int16Array);
  sensor.shares = unpacked(sensor.shares, Uint8Array);
}
const frames = report.time.length, joints = report.joints.length;
const duration = report.time[frames - 1];
const span = duration + 1 / report.fps; // s that all frames last, the last one too

const ORIGIN_COLORS = report.colors.origins, TERM_COLORS = report.colors.terms;
const UNKNOWN = report.colors.unknown, NO_RATE = 255;

function rgb(hex) {
  return [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
}

function mixed(a, b, share) {
  return a.map((value, k) => Math.round(value + (b[k] - value) * share));
}

const [LOW, MIDDLE, HIGH] = report.colors.reliability.map(rgb);
function reliabilityColor(percent) {
  if (percent === NO_RATE) return rgb(UNKNOWN);
  const share = Math.min(percent, 100) / 50;
  return share < 1 ? mixed(LOW, MIDDLE, share) : mixed(MIDDLE, HIGH, share - 1);
}
