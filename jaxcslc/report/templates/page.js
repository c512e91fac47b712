"use strict";
(function () {
  function ordered(a, b) {
    if (a === b) return 0;
    if (a === "") return 1;
    if (b === "") return -1;
    const x = a === "inf" ? Infinity : a === "-inf" ? -Infinity : Number(a);
    const y = b === "inf" ? Infinity : b === "-inf" ? -Infinity : Number(b);
    if (!Number.isNaN(x) && !Number.isNaN(y)) return x - y;
    return a.localeCompare(b, undefined, { numeric: true });
  }
  document.querySelectorAll("table").forEach(function (table) {
    const titles = Array.from(table.tHead.rows[0].cells);
    titles.forEach(function (title, index) {
      title.querySelector("button").addEventListener("click", function () {
        const down = title.getAttribute("aria-sort") === "ascending";
        titles.forEach((other) => other.removeAttribute("aria-sort"));
        title.setAttribute("aria-sort", down ? "descending" : "ascending");
        const key = (row) => row.cells[index].dataset.order;
        const rows = Array.from(table.tBodies[0].rows);
        rows.sort((a, b) => (key(a) === "" || key(b) === "" || !down ? 1 : -1) * ordered(key(a), key(b)));
        rows.forEach((row) => table.tBodies[0].appendChild(row));
      });
    });
  });
  if (typeof Plotly === "undefined") return;
  const options = { responsive: true, displaylogo: false, showSendToCloud: false, modeBarButtonsToRemove: ["select2d", "lasso2d", "zoomIn2d", "zoomOut2d", "autoScale2d"] };
  const touch = window.matchMedia("(pointer: coarse)").matches;
  const charts = Array.from(document.querySelectorAll("script[data-chart]"));
  function draw() {
    const source = charts.shift();
    if (!source) return;
    const figure = JSON.parse(source.textContent);
    if (touch) figure.layout.dragmode = false; // a finger scrolls the page
    Plotly.newPlot(source.dataset.chart, figure.data, figure.layout, options).then(() => setTimeout(draw, 0));
  }
  draw();
  document.querySelectorAll("details").forEach(function (part) {
    part.addEventListener("toggle", () => part.querySelectorAll(".js-plotly-plot").forEach((chart) => Plotly.Plots.resize(chart)));
  });
})();
