// The table of metrics and that of distances moved.

function addRow(table, kind, cells) {
  const row = element("tr");
  for (const [text, classes = ""] of cells) row.append(element(kind, text, classes));
  table.append(row);
  return row;
}

function figure(value) {
  if (value === null) return "–";
  return Math.abs(value) < 1e-6 ? "0" : String(Number(value.toPrecision(3)));
}

function fillMetrics(table) {
  addRow(table, "th", [["metric", "text"], ["", "text"], ["raw"], ["clean"],
                       ["fails if", "text"], ["", "text"]]);
  for (const metric of report.metrics) {
    const failed = metric.limits.some((limit) => limit.fails);
    const limits = metric.limits.map((limit) => limit.text).join(", ");
    const word = !metric.limits.length ? ""
      : metric.clean === null ? "not measured" : failed ? "fail" : "pass";
    addRow(table, "td", [[metric.name, "text"], [metric.meaning, "text"],
      [figure(metric.raw)], [figure(metric.clean)], [limits, "text"],
      [word, `text ${word === "fail" || word === "pass" ? word : ""}`]]);
  }
}

// Mean and greatest of a joint's distances [cm].
function moved(millimeters, joint) {
  let sum = 0, count = 0, most = 0;
  for (let f = 0; f < frames; f++) {
    const value = millimeters[f * joints + joint];
    if (value === MISSING) continue;
    sum += value;
    count += 1;
    most = Math.max(most, value);
  }
  return count ? { mean: sum / count / 10, most: most / 10 } : null;
}

function fillMoved(table) {
  addRow(table, "th", [["joint", "text"], ["reliability"], ["filled"],
    ["by correction, mean", "text"], ["most, cm"], ["by physics, mean", "text"],
    ["most, cm"]]);
  const by = ["correction", "physics"].map((name) =>
    report.joints.map((_, j) => moved(report[name], j)));
  const widest = Math.max(...by.flat().map((m) => (m ? m.mean : 0)), 0.1);
  report.joints.forEach((joint, j) => {
    let rate = 0, known = 0, filled = 0;
    for (let f = 0; f < frames; f++) {
      const percent = report.reliability[f * joints + j];
      if (percent !== NO_RATE) [rate, known] = [rate + percent / 100, known + 1];
      filled += report.origin[f * joints + j] === 2;
    }
    const row = addRow(table, "td", [[joint, "text"], [known ? (rate / known).toFixed(2) : "–"],
      [`${Math.round((100 * filled) / frames)}%`]]);
    by.forEach((distances, n) => {
      const distance = distances[j];
      const cell = element("td", distance ? `${distance.mean.toFixed(1)} cm` : "–",
        "bars");
      if (distance) {
        const bar = element("span", "", "strip");
        bar.style.width = `${(65 * distance.mean) / widest}%`;
        bar.style.background = n ? "#20908d" : "#f0a028";
        cell.append(bar);
      }
      row.append(cell, element("td", distance ? distance.most.toFixed(1) : "–"));
    });
  });
}
