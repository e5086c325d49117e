// Puts the report together and plays it.

const scrubber = at("scrubber");
let frame = 0, playing = false, seconds = 0, stamp = null;

const WHITE = [246, 247, 249], FAR = 200; // mm: the distance shown in full color
const cm = (value) => (value === MISSING ? "unknown" : `${(value / 10).toFixed(1)} cm`);
const word = (names, k) => names[k] || "unknown";
const rate = (k) => (report.reliability[k] === NO_RATE ? "reliability unknown"
  : `reliability ${report.reliability[k]}%, decided by ${word(report.terms, report.term[k])}`);
const tip = (k) =>
  `${rate(k)}\n` +
  `origin: ${word(report.origins, report.origin[k])}\n` +
  `moved by correction ${cm(report.correction[k])}, by physics ${cm(report.physics[k])}\n` +
  `uncertainty ${cm(report.uncertainty[k])}`;
const jointMap = (title, badness, color, legend) =>
  ({ title, rows: report.joints, tip, badness, color, legend });
const distanceMap = (title, values, hex, far = FAR, tipOf = tip) => ({
  title, rows: report.joints, tip: tipOf,
  badness: (k) => values[k],
  color: (k) => values[k] === MISSING ? [120, 120, 128]
    : mixed(WHITE, rgb(hex), Math.min(values[k] / far, 1)),
  legend: [[WHITE, "0"], [hex, `${far / 10} cm or more`], ["#787880", "unknown"]],
});
const unreliability = (k) => -report.reliability[k];
const MAPS = [
  jointMap("Reliability", unreliability, (k) => reliabilityColor(report.reliability[k]),
    [[LOW, "0%"], [MIDDLE, "50%"], [HIGH, "100%"]]),
  jointMap("Origin", (k) => report.origin[k],
    (k) => rgb(ORIGIN_COLORS[report.origin[k]] || UNKNOWN),
    report.origins.map((name, k) => [ORIGIN_COLORS[k], name])),
  jointMap("Deciding term (paler: more reliable)", unreliability,
    (k) => report.reliability[k] === NO_RATE ? rgb(UNKNOWN)
      : mixed(rgb(TERM_COLORS[report.term[k]] || UNKNOWN), WHITE, report.reliability[k] / 100),
    report.terms.map((name, k) => [TERM_COLORS[k] || UNKNOWN, name])),
  distanceMap("Uncertainty", report.uncertainty, "#7b3fa0", 100),
  distanceMap("Moved by correction", report.correction, "#b45309"),
  distanceMap("Moved by physics", report.physics, "#0f6e6c"),
  { title: "Contacts", rows: report.parts,
    tip: (k) => (report.contacts[k] ? "on the floor" : "in the air"),
    badness: (k) => -report.contacts[k],
    color: (k) => (report.contacts[k] ? rgb("#2f9e57") : WHITE),
    legend: [["#2f9e57", "on the floor"], [WHITE, "in the air"]] },
];

const go = (to) => {
  frame = Math.min(Math.max(to, 0), frames - 1);
  seconds = report.time[frame];
  show();
};
const plots = MAPS.map((map) => addMap(at("maps"), map, go));
for (const { name, raw, clean } of report.curves) {
  const lines = [["raw", raw, "#d9731a"], ["clean", clean, "#2a63b0"]];
  plots.push(addCurve(at("curves"), { name, lines }, go));
}
if (report.sensors.length) plots.push(...addSession(go));

function show() {
  drawFigures(frame);
  scrubber.value = frame;
  at("clock").textContent = `${clock(frame)} of ${frames}`;
  if (report.sensors.length) drawRoom(frame);
  for (const plot of plots) plot.show(frame);
}

function redraw() {
  for (const plot of plots) plot.redraw();
  show();
}

function tick(now) {
  if (!playing) return;
  seconds += stamp === null ? 0 : ((now - stamp) / 1000) * Number(at("pace").value);
  stamp = now;
  if (seconds > duration) seconds = 0;
  const next = frameAt(report.time, seconds);
  if (next !== frame) {
    frame = next;
    show();
  }
  requestAnimationFrame(tick);
}

function play() {
  [playing, stamp] = [!playing, null];
  at("play").textContent = playing ? "Pause" : "Play";
  if (playing) requestAnimationFrame(tick);
}

scrubber.max = frames - 1;
scrubber.addEventListener("input", () => go(Number(scrubber.value)));
at("play").addEventListener("click", play);
for (const name of ["over", "follow"]) {
  at(name).checked = view[name];
  at(name).addEventListener("change", () => {
    view[name] = at(name).checked;
    show();
  });
}
document.addEventListener("keydown", (e) => {
  if (["INPUT", "SELECT", "BUTTON"].includes(e.target.tagName)) return;
  const steps = { ArrowLeft: -1, ArrowRight: 1 };
  if (e.key === " ") play();
  else if (e.key in steps) go(frame + steps[e.key]);
  else return;
  e.preventDefault();
});
turnByMouse(canvas, view, show);
turnByMouse(room, roomView, show);
window.addEventListener("resize", redraw);
at("source").textContent = report.source;
at("facts").textContent = `${report.skeleton}, ${frames} frames, ` +
  `${duration.toFixed(1)} s, ${report.fps.toFixed(1)} frames per second`;
at("damage").append(...report.damage.map((sentence) => element("li", sentence)));
fillMetrics(at("metrics"));
fillMoved(at("moved"));
redraw();
