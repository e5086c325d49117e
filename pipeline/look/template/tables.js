// The tables of metrics and of distances moved.

// Adds a row of cells [text, CSS classes].
function addRow(table, kind, cells) {
  const row = element("tr");
  row.append(...cells.map(([text, classes]) => element(kind, text, classes)));
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
  for (const { name, meaning, raw, clean, limits } of report.metrics) {
    const verdict = limits.some((limit) => limit.fails) ? "fail" : "pass";
    const word = !limits.length ? "" : clean === null ? "not measured" : verdict;
    addRow(table, "td", [[name, "text"], [meaning, "text"], [figure(raw)], [figure(clean)],
      [limits.map((limit) => limit.text).join(", "), "text"], [word, `text ${word}`]]);
  }
}

function fillMoved(table) {
  addRow(table, "th", [["joint", "text"], ["reliability"], ["filled"],
    ["by correction: mean, cm", "text"], ["max, cm"],
    ["by physics: mean, cm", "text"], ["max, cm"]]);
  const { reliability, filled, by } = report.moved;
  const widest = Math.max(...by.flatMap(({ mean }) => mean), 0.1);
  const fixed = (value, digits) => (value === null ? "–" : value.toFixed(digits));
  report.joints.forEach((joint, j) => {
    const row = addRow(table, "td", [[joint, "text"], [fixed(reliability[j], 2)],
      [`${Math.round(100 * filled[j])}%`]]);
    by.forEach(({ mean, most }, n) => {
      const cell = element("td", fixed(mean[j], 1), "bars"), bar = element("span", "", "strip");
      bar.style.width = `${(65 * mean[j]) / widest}%`;
      bar.style.background = n ? "#20908d" : "#f0a028";
      cell.append(bar);
      row.append(cell, element("td", fixed(most[j], 1)));
    });
  });
}
