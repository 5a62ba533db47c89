"use strict";
// Turns the drawn pictures of the flights into charts that zoom. Without it the pictures stay.
(() => {
  const flights = JSON.parse(document.getElementById("series").textContent);
  const root = document.documentElement;
  root.classList.add("scripted");

  const numbers = text => {
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    return Array.from(new Float32Array(bytes.buffer), v => Number.isNaN(v) ? null : v);
  };
  const colour = name => getComputedStyle(root).getPropertyValue("--" + name).trim();
  const DASH = {paper: [6, 3], hold: [2, 3]};
  const charts = new Map(); // panel -> its chart
  const range = new Map(); // flight -> [from, to] that its charts show; absent: all
  let spreading = false;

  const spread = (flight, from, to) => { // one flight, one range of time
    const t = flight.t, all = from <= t[0] && to >= t[t.length - 1];
    if (all) range.delete(flight); else range.set(flight, [from, to]);
    spreading = true;
    for (const chart of flight.charts_drawn) chart.setScale("x", {min: from, max: to});
    spreading = false;
  };

  const options = (flight, data, width) => {
    const axis = {stroke: colour("muted"), grid: {stroke: colour("grid"), width: 1}, ticks: {stroke: colour("grid"), width: 1},
      font: "11px system-ui, sans-serif"};
    return {
      width, height: Math.max(150, Math.min(230, Math.round(width * 0.36))),
      padding: [8, 12, 0, 0],
      scales: {x: {time: false}},
      cursor: {y: false, drag: {x: true, y: false}, sync: {key: "flight" + flight.number}, points: {size: 5}},
      legend: {live: true},
      series: [{label: "t", value: (_, v) => v == null ? "–" : v.toFixed(2) + " s"},
        ...data.lines.map(line => ({label: line.name, stroke: colour(line.role), width: line.role === "measured" ? 2.4 : 1.4,
          dash: DASH[line.role], points: {show: false}, value: (_, v) => v == null ? "–" : v.toFixed(3)}))],
      axes: [{...axis, size: 30}, {...axis, size: 46}],
      hooks: {setScale: [(chart, key) => {
        if (key === "x" && !spreading && chart.status) spread(flight, chart.scales.x.min, chart.scales.x.max);
      }]},
    };
  };

  const draw = panel => {
    const flight = flights[panel.closest(".flight").dataset.flight];
    const data = flight.charts[panel.dataset.chart];
    flight.t = Array.isArray(flight.t) ? flight.t : numbers(flight.t);
    data.y = data.y || data.lines.map(line => numbers(line.y));
    const place = panel.querySelector(".live");
    panel.classList.add("drawn");
    const chart = new uPlot(options(flight, data, place.clientWidth), [flight.t, ...data.y], place);
    charts.set(panel, chart);
    (flight.charts_drawn = flight.charts_drawn || new Set()).add(chart);
    const shown = range.get(flight);
    if (shown) { spreading = true; chart.setScale("x", {min: shown[0], max: shown[1]}); spreading = false; }
  };

  const erase = panel => {
    const chart = charts.get(panel);
    flights[panel.closest(".flight").dataset.flight].charts_drawn.delete(chart);
    charts.delete(panel);
    chart.destroy();
  };

  flights.forEach((flight, number) => { flight.number = number; });
  const panels = [...document.querySelectorAll(".motion")];
  const seen = new IntersectionObserver(entries => {
    for (const entry of entries) if (entry.isIntersecting && !charts.has(entry.target)) draw(entry.target);
  }, {rootMargin: "400px"});
  const sized = new ResizeObserver(entries => {
    for (const entry of entries) {
      const chart = charts.get(entry.target), width = entry.target.clientWidth;
      if (chart && width && Math.abs(chart.width - width) > 1) chart.setSize({width, height: chart.height});
    }
  });
  panels.forEach(panel => { seen.observe(panel); sized.observe(panel); });

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const panel of [...charts.keys()]) { erase(panel); draw(panel); }
  });
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach(d => { d.open = true; }));

  document.querySelectorAll(".flight").forEach(element => {
    const flight = flights[element.dataset.flight];
    element.querySelector(".tools").addEventListener("click", event => {
      const what = event.target.dataset.do;
      if (!what || !flight.charts_drawn) return;
      const first = flight.t[0], last = flight.t[flight.t.length - 1];
      let [from, to] = range.get(flight) || [first, last];
      const half = (to - from) / 2, middle = (from + to) / 2;
      if (what === "in") [from, to] = [middle - half / 2, middle + half / 2];
      if (what === "out") [from, to] = [middle - 2 * half, middle + 2 * half];
      if (what === "left") [from, to] = [from - half, to - half];
      if (what === "right") [from, to] = [from + half, to + half];
      if (what === "all") [from, to] = [first, last];
      const width = Math.min(to - from, last - first);
      from = Math.max(first, Math.min(from, last - width));
      spread(flight, from, from + width);
    });
  });
})();
