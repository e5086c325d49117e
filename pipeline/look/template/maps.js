// Heat maps of joints over time, and curves. They share a cursor; a click moves it.

const LABELS = 104, AXIS = 18, ROW = 13; // px

// The frames in a column, [first, end). Columns are even in time, whatever the sensor
// dropped; a tolerance allows for frames that are not quite even.
function framesOf(column, columns) {
  const wide = span / columns, skew = 0.25 / report.fps;
  const first = frameAt(report.time, column * wide + skew);
  const next = column + 1 < columns ? frameAt(report.time, (column + 1) * wide + skew) : frames;
  return [first, Math.max(first + 1, next)];
}

// The cell that a column shows in a row: that of its worst frame.
function worst(map, row, [first, next]) {
  const rows = map.rows.length;
  let cell = first * rows + row;
  for (let f = first + 1; f < next; f++) {
    if (map.badness(f * rows + row) > map.badness(cell)) cell = f * rows + row;
  }
  return cell;
}

// The map as a picture with one pixel per cell.
function picture(map, columns) {
  const bitmap = element("canvas");
  [bitmap.width, bitmap.height] = [columns, map.rows.length];
  const context = bitmap.getContext("2d");
  const image = context.createImageData(columns, map.rows.length);
  for (let column = 0; column < columns; column++) {
    const under = framesOf(column, columns);
    map.rows.forEach((_, row) => {
      const color = map.color(worst(map, row, under));
      image.data.set([...color, 255], 4 * (row * columns + column));
    });
  }
  context.putImageData(image, 0, 0);
  return bitmap;
}

function legend(entries) {
  const line = element("p", "", "legend");
  for (const [color, text] of entries) {
    const patch = element("i");
    patch.style.background = Array.isArray(color) ? `rgb(${color})` : color;
    line.append(patch, text);
  }
  return line;
}

function lettering(context, align, color = "#667085", font = "11px") {
  context.fillStyle = color;
  context.font = `${font} system-ui, 'DejaVu Sans', sans-serif`;
  context.textAlign = align;
}

function timeAxis(context, width, height) {
  const step = [0.5, 1, 2, 5, 10, 30, 60, 120, 300, 600, 1800].find(
    (s) => span / s <= 10) || 3600;
  lettering(context, "center");
  for (let t = 0; t <= duration; t += step) {
    const x = LABELS + ((width - LABELS) * t) / span;
    context.fillText(t === 0 ? "0 s" : String(t), Math.min(x, width - 10), height - 4);
  }
}

// Adds a plot with cursor, tooltip and clicks. `draw` paints it on its canvas, `tip`
// returns the tooltip's text, `go` moves the page to a frame.
function addPlot(parent, title, entries, height, draw, tip, go) {
  const box = element("div"), plot = element("div", "", "plot");
  const surface = element("canvas"), cursor = element("div", "", "cursor");
  surface.style.height = `${height}px`;
  plot.append(surface, cursor);
  box.append(element("h3", title), legend(entries), plot);
  parent.append(box);
  // The share of the time left of the pointer; negative over the labels.
  const shareUnder = (e) => {
    const area = surface.getBoundingClientRect();
    return Math.min((e.clientX - area.left - LABELS) / (area.width - LABELS), 1);
  };
  plot.addEventListener("pointerdown", (e) => {
    const share = shareUnder(e);
    if (share >= 0) go(frameAt(report.time, share * span));
  });
  plot.addEventListener("pointermove", (e) => {
    const share = shareUnder(e), top = surface.getBoundingClientRect().top;
    showTip(e, share < 0 ? null : tip(share, e.clientY - top));
  });
  plot.addEventListener("pointerleave", (e) => showTip(e, null));
  return {
    redraw: () => draw(stage(surface)),
    show: (frame) => {
      const wide = surface.clientWidth - LABELS;
      cursor.style.left = `${LABELS + (wide * report.time[frame]) / span}px`;
    },
  };
}

function showTip(e, text) {
  const tip = at("tip");
  tip.hidden = text === null;
  if (tip.hidden) return;
  tip.textContent = text;
  tip.style.left = `${Math.min(e.clientX + 14, window.innerWidth - tip.offsetWidth - 8)}px`;
  tip.style.top = `${Math.min(e.clientY + 14, window.innerHeight - tip.offsetHeight - 8)}px`;
}

function addMap(parent, map, go) {
  const high = map.rows.length * ROW;
  let columns = 1;
  const draw = ({ context, width, height }) => {
    columns = Math.max(1, Math.min(frames, Math.floor(width - LABELS)));
    context.imageSmoothingEnabled = false;
    context.drawImage(picture(map, columns), LABELS, 0, width - LABELS, high);
    lettering(context, "right", "#1d2330");
    map.rows.forEach((row, k) => context.fillText(row, LABELS - 6, ROW * (k + 0.8)));
    timeAxis(context, width, height);
  };
  const tip = (share, y) => {
    const row = Math.floor(y / ROW);
    if (!(row in map.rows)) return null;
    const column = Math.min(Math.floor(share * columns), columns - 1);
    const cell = worst(map, row, framesOf(column, columns));
    return `${map.rows[row]}, ${clock(Math.floor(cell / map.rows.length))}\n${map.tip(cell)}`;
  };
  return addPlot(parent, map.title, map.legend, high + AXIS, draw, tip, go);
}

function addCurve(parent, curve, go) {
  const finite = curve.lines.flatMap(([, values]) => [...values]).filter(isFinite)
    .sort((a, b) => a - b);
  // A few high peaks must not flatten everything else.
  const most = finite.length ? 1.1 * finite[Math.floor(0.995 * (finite.length - 1))] : 1;
  const top = most || 1, tall = 150;
  const draw = ({ context, width, height }) => {
    lettering(context, "right");
    context.fillText(String(Number(top.toPrecision(2))), LABELS - 6, 10);
    context.fillText("0", LABELS - 6, tall);
    context.strokeStyle = "#d9dde5";
    context.strokeRect(LABELS + 0.5, 0.5, width - LABELS - 1, tall);
    const place = (value, f) => [LABELS + ((width - LABELS) * report.time[f]) / span,
      tall * (1 - Math.min(value / top, 1))];
    for (const [, values, color] of curve.lines) {
      [context.strokeStyle, context.lineWidth] = [color, 1.3];
      context.beginPath();
      values.forEach((value, f) => { // moving to or drawing to NaN does nothing
        if (isFinite(values[f - 1])) context.lineTo(...place(value, f));
        else context.moveTo(...place(value, f));
      });
      context.stroke();
    }
    timeAxis(context, width, height);
  };
  const words = (value) => (isFinite(value) ? value.toPrecision(3) : "unknown");
  const tip = (share) => {
    const f = frameAt(report.time, share * span);
    return [clock(f), ...curve.lines.map(([name, v]) => `${name} ${words(v[f])}`)].join("\n");
  };
  return addPlot(parent, curve.name, curve.legend || [], tall + AXIS, draw, tip, go);
}

const clock = (frame) => `${report.time[frame].toFixed(2)} s, frame ${frame + 1}`;
