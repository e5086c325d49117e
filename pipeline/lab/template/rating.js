// Shows one trial after another, stores the grades, and saves them to a file at the end.

const kit = JSON.parse(at("data").textContent, unpacked);
const LOOK = { Left: "#2a63b0", Right: "#d9731a", "": "#465066" };
const sides = kit.joints.map((name) => (name.match(/Left$|Right$/) || [""])[0]);
const LOWEST_LABEL = `1, not ${kit.word} at all`;
const HIGHEST_LABEL = `${kit.highest}, very ${kit.word}`;
const PAUSE = 0.5; // s at the end, before a motion repeats

let rater = "", order = [], answers = [], trial = 0, framed = 0, panes = [];
let view = null, motion = null, playing = false, seconds = 0, stamp = null;

// Half of the raters see swapped sides; half of each group see the trials in reverse order.
function orderFor(name) {
  let hash = 7;
  for (const c of name) hash = (Math.imul(hash, 31) + c.codePointAt(0)) >>> 0;
  hash ^= hash >>> 15;
  const shown = kit.trials.map((clips) => (hash & 1 ? [...clips].reverse() : clips));
  return hash & 2 ? shown.reverse() : shown;
}

const storageName = () => `kinefilter ratings ${kit.page} ${rater}`;
function store() {
  try {
    localStorage.setItem(storageName(), JSON.stringify({ answers, trial }));
  } catch { /* the browser has no storage */ }
}

function stored() {
  try {
    return JSON.parse(localStorage.getItem(storageName())) || {};
  } catch {
    return {};
  }
}

function start(event) {
  event.preventDefault();
  rater = at("rater").value.trim();
  if (!rater) return;
  order = orderFor(rater);
  ({ answers = order.map((shown) => ({ shown, grades: shown.map(() => null) })),
    trial = 0 } = stored());
  show(trial);
}

const section = (id) => ["welcome", "trial", "end"].forEach((s) => (at(s).hidden = s !== id));

function show(to) {
  trial = Math.max(0, to);
  store();
  if (trial >= order.length) {
    playing = false;
    return section("end");
  }
  section("trial");
  const clips = order[trial].map((k) => kit.clips[k]);
  motion = kit.motions[clips[0].motion];
  view = { yaw: motion.yaw, pitch: 0.16, zoom: 1 };
  panes = clips.map((clip, k) => addPane(clip, clips[1] ? "AB"[k] : "The figure", k));
  if (motion.reference) panes.unshift(addPane(motion.reference, "What the person did"));
  at("panes").replaceChildren(...panes.map((pane) => pane.box));
  at("count").textContent = `${trial + 1} of ${order.length}`;
  [at("done").max, at("done").value] = [order.length, trial];
  at("back").disabled = trial === 0;
  at("scrubber").max = motion.seconds;
  [framed, seconds] = [0, 0];
  mark();
  draw();
  play(true);
}

function addPane(clip, title, k = null) {
  const box = element("div", "", "pane"), canvas = element("canvas");
  const grades = element("div", "", "grades"), ends = element("div", "", "ends");
  box.append(element("h3", title), canvas);
  for (let grade = 1; k !== null && grade <= kit.highest; grade++) {
    const button = element("button", String(grade));
    button.addEventListener("click", () => setGrade(k, grade));
    grades.append(button);
  }
  if (k !== null) {
    ends.append(element("span", LOWEST_LABEL), element("span", HIGHEST_LABEL));
    box.append(grades, ends);
  }
  turnByMouse(canvas, view, draw);
  return { clip, box, canvas, k, buttons: [...grades.children] };
}

function setGrade(k, grade) {
  answers[trial].grades[k] = grade;
  const open = answers[trial].grades.indexOf(null);
  framed = open < 0 ? k : open;
  store();
  mark();
}

function frameOnly(k) {
  framed = Math.min(k, answers[trial].grades.length - 1);
  mark();
}

function mark() {
  const { grades } = answers[trial];
  for (const { k, box, buttons } of panes) {
    box.classList.toggle("framed", grades.length > 1 && k === framed);
    buttons.forEach((b, n) => b.setAttribute("aria-pressed", String(grades[k] === n + 1)));
  }
  at("next").disabled = grades.includes(null);
}

function draw() {
  for (const { clip, canvas } of panes) {
    const { context, width, height } = stage(canvas);
    const { tall, center: [x, z] } = motion, center = [x, 0.5 * tall, z];
    const pixel = Math.min((0.75 * height) / tall, (0.9 * width) / motion.wide); // per mm
    const shown = (0.85 * Math.min(width, height)) / pixel, thick = 75 * pixel * view.zoom;
    const project = projection(view, tall, shown, center, 0, width, height);
    const frame = frameAt(clip.time, seconds);
    const figure = (seen, look) =>
      drawFigure(context, seen, clip.positions, kit.parents, frame, look);
    const shade = () => "#d3d9e3";
    drawFloor(context, project, center);
    figure((a, _, c) => project(a, 0, c), { width: thick, radius: 0, bone: shade, joint: shade });
    const color = (k) => LOOK[sides[k % sides.length]];
    const points = figure(project, { width: thick, radius: thick / 3, bone: color, joint: color });
    const head = points[kit.joints.indexOf("Head")];
    if (!head) continue;
    context.fillStyle = LOOK[""];
    context.beginPath();
    context.arc(...head, 1.4 * thick, 0, 7);
    context.fill();
  }
  at("scrubber").value = seconds;
  at("clock").textContent = `${seconds.toFixed(1)} of ${motion.seconds.toFixed(1)} s`;
}

function tick(now) {
  if (!playing) return;
  seconds += stamp === null ? 0 : (now - stamp) / 1000;
  stamp = now;
  if (seconds > motion.seconds + PAUSE) seconds = 0;
  draw();
  requestAnimationFrame(tick);
}

function play(on) {
  const idle = !playing;
  [playing, stamp] = [on, null];
  at("play").textContent = on ? "Pause" : "Play";
  if (on && idle) requestAnimationFrame(tick);
}

function seek(to) {
  play(false);
  seconds = Math.min(Math.max(to, 0), motion.seconds);
  draw();
}

function save() {
  const { page, seed, question } = kit, saved = new Date().toISOString();
  const text = JSON.stringify({ page, seed, question, rater, saved, answers }, null, 1);
  const link = element("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
  link.download = `answers-${rater.replace(/[^\p{L}\p{N}-]+/gu, "_")}.json`;
  link.click();
}

const KEYS = {
  Enter: () => at("next").click(), Backspace: () => at("back").click(),
  " ": () => play(!playing),
  ArrowLeft: () => seek(seconds - 1 / 30), ArrowRight: () => seek(seconds + 1 / 30),
  a: () => frameOnly(0), b: () => frameOnly(1),
};
document.addEventListener("keydown", (e) => {
  if (at("trial").hidden || e.ctrlKey || e.altKey || e.metaKey) return;
  if (e.target.tagName === "BUTTON" && "Enter ".includes(e.key)) return;
  if (/^[1-9]$/.test(e.key)) setGrade(framed, Number(e.key));
  else if (e.key in KEYS) KEYS[e.key]();
  else return;
  e.preventDefault();
});
document.addEventListener("click", (e) => {
  if (e.detail) e.target.blur(); // so that the page receives key presses again
});
at("start").addEventListener("submit", start);
at("play").addEventListener("click", () => play(!playing));
at("scrubber").addEventListener("input", () => seek(Number(at("scrubber").value)));
at("next").addEventListener("click", () => show(trial + 1));
at("back").addEventListener("click", () => show(trial - 1));
at("review").addEventListener("click", () => show(order.length - 1));
at("save").addEventListener("click", save);
window.addEventListener("resize", () => panes.length && draw());
at("question").textContent = kit.question;
const pair = kit.trials[0].length > 1;
at("task").textContent =
  `There are ${kit.trials.length} steps. Each shows ${pair ? "two figures" : "a figure"}` +
  ` that move${pair ? "" : "s"}${kit.motions[0].reference ? ", and what the person did" : ""}.` +
  ` Grade ${pair ? "each" : "it"} from ${LOWEST_LABEL}, to ${HIGHEST_LABEL}.`;
