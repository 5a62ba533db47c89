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
  const DASH = {paper: [6, 3], hold: [2, 3], "model-2": [7, 3], "model-3": [2, 2], "model-4": [8, 3, 2, 3], "model-5": [4, 2], "model-6": [12, 4]};
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

  const apart = (chart, data) => { // ranges of time that are set apart, behind everything
    const {ctx, bbox} = chart, at = x => Math.max(bbox.left, Math.min(bbox.left + bbox.width, chart.valToPos(x, "x", true)));
    ctx.fillStyle = colour("apart");
    for (const [from, to] of data.apart || []) ctx.fillRect(at(from), bbox.top, at(to) - at(from), bbox.height);
  };
  const moments = (chart, data) => { // alarms
    const {ctx, bbox} = chart, {min, max} = chart.scales.x;
    ctx.save();
    ctx.strokeStyle = colour("red");
    ctx.lineWidth = 1.4 * devicePixelRatio;
    ctx.setLineDash([4 * devicePixelRatio, 3 * devicePixelRatio]);
    for (const x of data.moments || []) if (x >= min && x <= max) {
      const at = chart.valToPos(x, "x", true);
      ctx.beginPath();
      ctx.moveTo(at, bbox.top);
      ctx.lineTo(at, bbox.top + bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  };

  const options = (flight, data, width) => {
    const axis = {stroke: colour("muted"), grid: {stroke: colour("grid"), width: 1}, ticks: {stroke: colour("grid"), width: 1},
      font: "11px system-ui, sans-serif"};
    return {
      width, height: Math.max(150, Math.min(230, Math.round(width * 0.36))),
      padding: [8, 12, 0, 0],
      scales: {x: {time: false}, ...(data.range ? {y: {range: data.range}} : {})},
      bands: (data.areas || []).map(pair => ({series: pair, fill: colour("shade")})),
      cursor: {y: false, drag: {x: true, y: false}, sync: {key: "flight" + flight.number}, points: {size: 5}},
      legend: {live: true},
      series: [{label: "t", value: (_, v) => v == null ? "–" : v.toFixed(2) + " s"},
        ...data.lines.map(line => ({label: line.name, stroke: colour(line.role), width: {measured: 2.4, end: 0}[line.role] ?? 1.4,
          dash: DASH[line.role], points: {show: false}, value: (_, v) => v == null ? "–" : v.toFixed(3)}))],
      axes: [{...axis, size: 30}, {...axis, size: 46}],
      hooks: {drawClear: [chart => apart(chart, data)], draw: [chart => moments(chart, data)], setScale: [(chart, key) => {
        if (key === "x" && !spreading && chart.status) spread(flight, chart.scales.x.min, chart.scales.x.max);
      }]},
    };
  };

  const clamp = (flight, from, to) => { // within the flight, as wide as asked
    const first = flight.t[0], last = flight.t[flight.t.length - 1], width = Math.min(to - from, last - first);
    from = Math.max(first, Math.min(from, last - width));
    spread(flight, from, from + width);
  };
  const act = (flight, what) => {
    const first = flight.t[0], last = flight.t[flight.t.length - 1];
    const [from, to] = range.get(flight) || [first, last], half = (to - from) / 2, middle = (from + to) / 2;
    if (what === "in") clamp(flight, middle - half / 2, middle + half / 2);
    if (what === "out") clamp(flight, middle - 2 * half, middle + 2 * half);
    if (what === "left") clamp(flight, from - half, to - half);
    if (what === "right") clamp(flight, from + half, to + half);
    if (what === "all") clamp(flight, first, last);
  };
  const KEYS = {"+": "in", "=": "in", "-": "out", "0": "all", Home: "all"};
  const read = (chart, unit, step) => { // the arrow keys walk through what is shown, a hundredth of it at a time
    const t = chart.data[0], {min, max} = chart.scales.x;
    const last = chart.cursor.idx, stride = (max - min) / 100;
    let at = (last == null ? min : t[last]) + step * stride;
    at = Math.max(min, Math.min(max, at));
    const left = chart.valToPos(at, "x"), box = chart.over.getBoundingClientRect();
    chart.setCursor({left, top: box.height / 2});
    const k = chart.cursor.idx;
    if (k == null) return;
    const values = chart.series.slice(1).map((line, i) => {
      const value = chart.data[i + 1][k];
      return line.label + " " + (value == null ? "–" : value.toFixed(3));
    });
    figures.say(t[k].toFixed(2) + " s", values.join(", ") + " " + unit, box.left + left, box.top, box.bottom);
  };
  const keyed = (panel, place) => {
    place.tabIndex = 0;
    place.addEventListener("keydown", event => {
      const flight = flights[panel.closest(".flight").dataset.flight], chart = charts.get(panel);
      const step = {ArrowLeft: -1, ArrowRight: 1}[event.key], what = KEYS[event.key];
      if (!chart || event.ctrlKey || event.metaKey || event.altKey || !(step || what)) return;
      event.preventDefault();
      if (step && event.shiftKey) act(flight, step < 0 ? "left" : "right");
      else if (step) read(chart, flight.charts[panel.dataset.chart].unit, step);
      else act(flight, what);
    });
  };

  const draw = panel => {
    const flight = flights[panel.closest(".flight").dataset.flight];
    const data = flight.charts[panel.dataset.chart];
    flight.t = Array.isArray(flight.t) ? flight.t : numbers(flight.t);
    data.y = data.y || data.lines.map(line => numbers(line.y));
    const place = panel.querySelector(".live");
    panel.classList.add("drawn");
    if (!place.hasAttribute("tabindex")) keyed(panel, place);
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
  const folded = () => document.querySelectorAll("details:not([open]):not(.data):not(.second)");
  let unfolded = [];
  addEventListener("beforeprint", () => { unfolded = [...folded()]; unfolded.forEach(d => { d.open = true; }); });
  addEventListener("afterprint", () => unfolded.forEach(d => { d.open = false; }));

  document.querySelectorAll(".flight").forEach(element => {
    const flight = flights[element.dataset.flight];
    element.querySelector(".tools").addEventListener("click", event => {
      const what = event.target.dataset.do;
      if (!what || !flight.charts_drawn) return;
      act(flight, what);
    });
  });
})();
