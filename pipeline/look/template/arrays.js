// The data of the report, and the colors of reliability.

const report = JSON.parse(at("data").textContent, unpacked);
const frames = report.time.length, joints = report.joints.length;
const duration = report.time[frames - 1];
const span = duration + 1 / report.fps; // s, including the duration of the last frame

const ORIGIN_COLORS = report.colors.origins, TERM_COLORS = report.colors.terms;
const UNKNOWN = report.colors.unknown, NO_RATE = 255;

const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
const mixed = (a, b, share) => a.map((value, k) => Math.round(value + (b[k] - value) * share));

const [LOW, MIDDLE, HIGH] = report.colors.reliability.map(rgb);
function reliabilityColor(percent) {
  if (percent === NO_RATE) return rgb(UNKNOWN);
  const share = Math.min(percent, 100) / 50;
  return share < 1 ? mixed(LOW, MIDDLE, share) : mixed(MIDDLE, HIGH, share - 1);
}
