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

  const touch = window.matchMedia("(pointer: coarse)").matches;
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const sources = Array.from(document.querySelectorAll("script[data-chart]"));
  const figures = new Map(sources.map((source) => [source.dataset.chart, source]));

  // A chart's data and layout in the colours of the page.
  function figure(name) {
    const { data, layout } = JSON.parse(figures.get(name).textContent);
    const style = getComputedStyle(document.documentElement);
    const colour = (variable) => style.getPropertyValue(variable).trim();
    layout.paper_bgcolor = layout.plot_bgcolor = colour("--page");
    layout.font.color = colour("--text");
    for (const axes of [layout, layout.scene || {}]) {
      for (const axis of Object.keys(axes).filter((key) => /^[xyz]axis/.test(key))) {
        Object.assign(axes[axis], { gridcolor: colour("--line"), zerolinecolor: colour("--strong"), color: colour("--text") });
      }
    }
    data.filter((trace) => trace.type === "heatmap").forEach((trace) => (trace.colorscale[1][1] = colour("--page")));
    if (touch) layout.dragmode = false; // a finger scrolls the page
    return { data, layout };
  }
  const options = { responsive: true, displaylogo: false, displayModeBar: false };

  function draw(name) {
    const { data, layout } = figure(name);
    return Plotly.react(name, data, layout, options);
  }
  // Charts of one group have the same range of x.
  let leading = false;
  function follow(chart) {
    chart.on("plotly_relayout", function (change) {
      const range = Object.entries(change).filter(([key]) => key.startsWith("xaxis."));
      if (leading || !range.length) return;
      leading = true;
      const others = Array.from(document.querySelectorAll(".js-plotly-plot[data-group]"));
      const same = others.filter((other) => other !== chart && other.dataset.group === chart.dataset.group);
      Promise.all(same.map((other) => Plotly.relayout(other, Object.fromEntries(range)))).finally(() => (leading = false));
    });
  }
  // Charts that are folded away are drawn when they are shown.
  const waiting = new Set(figures.keys());
  const shown = (name) => !document.getElementById(name).closest("details:not([open])");
  function drawFirst(name) {
    waiting.delete(name);
    return draw(name).then((chart) => chart.dataset.group && follow(chart));
  }
  function next() {
    const name = Array.from(waiting).find(shown);
    if (name) drawFirst(name).then(() => setTimeout(next, 0));
  }
  next();
  const drawn = () => Array.from(figures.keys()).filter((name) => !waiting.has(name));
  dark.addEventListener("change", () => drawn().forEach(draw));
  document.querySelectorAll("details").forEach(function (part) {
    part.addEventListener("toggle", function () {
      next();
      part.querySelectorAll(".js-plotly-plot").forEach((chart) => Plotly.Plots.resize(chart));
    });
  });

  const dialog = document.getElementById("large");
  const large = dialog.querySelector(".large");
  document.querySelectorAll("[data-enlarge]").forEach(function (button) {
    button.addEventListener("click", function () {
      const { data, layout } = figure(button.dataset.enlarge);
      dialog.showModal();
      layout.height = large.clientHeight;
      Plotly.newPlot(large, data, layout, { ...options, displayModeBar: true });
    });
  });
  dialog.querySelector(".close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("close", () => Plotly.purge(large));

  // Paper has four charts of joints beside each other, and others by themselves.
  const paper = (chart) => (chart.closest(".grid") ? { width: 390, height: 260 } : { width: 780, height: 400 });
  window.addEventListener("beforeprint", function () {
    Array.from(waiting).filter(shown).forEach(drawFirst);
    document.querySelectorAll(".chart.js-plotly-plot").forEach((chart) => Plotly.relayout(chart, { ...paper(chart), autosize: false }));
  });
  window.addEventListener("afterprint", () => drawn().forEach(draw));
})();
