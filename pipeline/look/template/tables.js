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

function fillMoved(table) {
  addRow(table, "th", [["joint", "text"], ["reliability"], ["filled"],
    ["by correction, mean, cm", "text"], ["most, cm"],
    ["by physics, mean, cm", "text"], ["most, cm"]]);
  const { reliability, filled, by } = report.moved;
  const widest = Math.max(...by.flatMap(({ mean }) => mean), 0.1);
  const told = (value, digits) => (value === null ? "–" : value.toFixed(digits));
  report.joints.forEach((joint, j) => {
    const row = addRow(table, "td", [[joint, "text"], [told(reliability[j], 2)],
      [`${Math.round(100 * filled[j])}%`]]);
    by.forEach(({ mean, most }, n) => {
      const cell = element("td", told(mean[j], 1), "bars"), bar = element("span", "", "strip");
      bar.style.width = `${(65 * mean[j]) / widest}%`;
      bar.style.background = n ? "#20908d" : "#f0a028";
      cell.append(bar);
      row.append(cell, element("td", told(most[j], 1)));
    });
  });
}
