// The data of the page, its arrays unpacked.

const report = JSON.parse(document.getElementById("data").textContent);
const MISSING = -32768;

function unpacked(text, Numbers) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Numbers(bytes.buffer);
}

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

// An element with text, which is never markup.
function element(kind, text = "", classes = "") {
  const made = document.createElement(kind);
  made.textContent = text;
  made.className = classes;
  return made;
}

function frameAt(seconds) {
  let low = 0, high = frames - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (report.time[middle] <= seconds) low = middle;
    else high = middle - 1;
  }
  return low;
}
