// Plots. A WindowPlot asks the server for what its window and its pixels can show; a drawn chart holds its numbers itself.

import {h, later} from "./dom.js";
import {windowOf} from "./api.js";

export const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const DASH = {paper: [6, 3], hold: [2, 3], command: undefined};
const FONT = "11px system-ui, sans-serif";
const living = new Set();

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { for (const one of [...living]) one.rebuild(); });

function axes(right = null) {
  const one = {stroke: colour("muted"), grid: {stroke: colour("grid"), width: 1}, ticks: {stroke: colour("grid"), width: 1, size: 4}, font: FONT};
  const sides = [{...one, size: 28}, {...one, size: 48}];
  if (right) sides.push({...one, scale: right, side: 1, size: 44, grid: {show: false}});
  return sides;
}

const number = value => value === null || value === undefined ? "–" : Math.abs(value) >= 1e5 || (value && Math.abs(value) < 1e-3) ? value.toExponential(2) : value.toFixed(3);

function seriesOf(lines, exact, along = "t [s]") {
  return [{label: along, value: (_, v) => v === null || v === undefined ? "–" : v.toFixed(2)},
    ...lines.map(line => ({
      label: line.name, scale: line.scale || "y", stroke: colour(line.role), width: line.role === "measured" ? 1.8 : 1.4,
      dash: DASH[line.role], points: {show: false}, value: (_, v) => number(v),
      paths: line.stepped ? (u, i, a, b) => (exact() ? uPlot.paths.stepped({align: 1}) : uPlot.paths.linear())(u, i, a, b) : undefined,
    }))];
}

function even(_, low, high) { // zero in the middle, so that signs can be compared over two scales
  const reach = 1.08 * Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0)) || 1;
  return [-reach, reach];
}

class Sized { // keeps a chart as wide as its place, and lets it go when that is gone
  constructor(place) {
    this.place = place;
    this.chart = null;
    living.add(this);
    this.observer = new ResizeObserver(() => {
      if (!this.place.isConnected) return this.dispose();
      const width = this.place.clientWidth;
      if (this.chart && width && Math.abs(this.chart.width - width) > 1) { this.chart.setSize({width, height: this.chart.height}); this.resized(); }
      else if (!this.chart && width) this.rebuild();
      return undefined;
    });
    this.observer.observe(place);
  }
  resized() {}
  dispose() { this.observer.disconnect(); living.delete(this); if (this.chart) this.chart.destroy(); this.chart = null; }
}

export class Together { // plots that share one window of time
  constructor() { this.plots = new Set(); this.range = null; this.whole = null; }
  extend([first, last]) { this.whole = this.whole ? [Math.min(first, this.whole[0]), Math.max(last, this.whole[1])] : [first, last]; }
  show(from, to) {
    if (!this.whole) return;
    const [first, last] = this.whole, width = Math.min(to - from, last - first), least = Math.max(1e-4, (last - first) * 1e-7);
    const start = Math.max(first, Math.min(from, last - width));
    this.range = width >= last - first ? null : [start, start + Math.max(width, least)];
    for (const plot of this.plots) plot.show();
  }
  shown() { return this.range || this.whole; }
  move(what) {
    if (!this.whole) return;
    const [from, to] = this.shown(), half = (to - from) / 2, middle = (from + to) / 2;
    if (what === "in") this.show(middle - half / 2, middle + half / 2);
    if (what === "out") this.show(middle - 2 * half, middle + 2 * half);
    if (what === "left") this.show(from - half, to - half);
    if (what === "right") this.show(from + half, to + half);
    if (what === "all") this.show(...this.whole);
  }
  tools() {
    const button = (what, sign, words) => h("button", {type: "button", className: "small", title: words, "aria-label": words, onclick: () => this.move(what)}, sign);
    return h("div", {className: "tools", role: "group", "aria-label": "Window of time"},
      button("left", "‹", "Earlier"), button("right", "›", "Later"), button("in", "+", "Zoom in"), button("out", "−", "Zoom out"), button("all", "All", "Show all"));
  }
}

const KEYS = {ArrowLeft: "left", ArrowRight: "right", "+": "in", "=": "in", "-": "out", "0": "all"};

export class WindowPlot extends Sized {
  // lines: [{name, role, scale, stepped}]; along: what x is; bands: () => [{role, start, end}]; onmark: (from, to) => true where it took the drag
  constructor(place, {path, lines, together = new Together(), height = 190, label, bands = null, onmark = null, onloaded = null, onerror = null, legend = true, along}) {
    super(place);
    Object.assign(this, {path, lines, along, together, height, bands, onmark, onloaded, onerror, legend, data: null});
    place.classList.add("plot");
    place.tabIndex = 0;
    place.setAttribute("role", "img");
    place.setAttribute("aria-label", `${label}. Arrow keys move, plus and minus zoom, 0 shows all.`);
    place.addEventListener("keydown", event => {
      if (KEYS[event.key] && !event.ctrlKey && !event.metaKey && !event.altKey) { event.preventDefault(); together.move(KEYS[event.key]); }
    });
    place.addEventListener("wheel", event => this.wheel(event), {passive: false});
    this.ask = later(30, () => this.load());
    together.plots.add(this);
    this.asked = null;
    this.load();
  }
  async load() {
    if (!this.place.isConnected && this.data) return;
    if (this.asked) this.asked.abort();
    const asked = this.asked = new AbortController();
    const range = this.together.range, margin = range ? (range[1] - range[0]) / 2 : 0; // half a window on each side: panning starts at once
    const width = (this.place.clientWidth || 800) * (range ? 2 : 1);
    try {
      const began = performance.now();
      const data = await windowOf(this.path, range ? range[0] - margin : null, range ? range[1] + margin : null, width, asked.signal);
      if (asked !== this.asked) return;
      this.data = data;
      if (!range) this.together.extend(data.whole);
      if (!this.chart) this.rebuild();
      else this.chart.batch(() => { this.chart.setData([data.time, ...data.columns], false); this.put(); });
      performance.measure("rotorfit-plot", {start: began, end: performance.now()});
      this.place.dataset.loaded = String(Number(this.place.dataset.loaded || 0) + 1);
      if (this.onloaded) this.onloaded(data);
    } catch (error) {
      if (error.name !== "AbortError" && this.onerror) this.onerror(error);
    }
  }
  put() {
    const [min, max] = this.together.shown();
    this.chart.setScale("x", {min, max});
  }
  show() { // at once with what is there, then with what the window holds
    if (this.chart) this.put();
    this.ask();
  }
  resized() { this.ask(); }
  wheel(event) {
    if (!this.chart || !(event.ctrlKey || event.shiftKey || event.altKey || Math.abs(event.deltaX) > Math.abs(event.deltaY))) return;
    event.preventDefault();
    const [from, to] = this.together.shown();
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
      const step = (event.deltaX || event.deltaY) / 600 * (to - from);
      return void this.together.show(from + step, to + step);
    }
    const at = this.chart.posToVal(event.clientX - this.chart.over.getBoundingClientRect().left, "x"), factor = Math.exp(event.deltaY / 300);
    this.together.show(at - (at - from) * factor, at + (to - at) * factor);
  }
  rebuild() {
    if (!this.data || !this.place.clientWidth) return;
    if (this.chart) this.chart.destroy();
    const right = this.lines.find(line => line.scale && line.scale !== "y");
    this.chart = new uPlot({
      width: this.place.clientWidth, height: this.height, padding: [8, right ? 2 : 12, 0, 0],
      scales: {x: {time: false}, y: right ? {range: even} : {}, ...(right ? {[right.scale]: {range: even}} : {})},
      cursor: {y: false, drag: {x: true, y: false, setScale: false}, points: {size: 5}},
      legend: {show: this.legend}, series: seriesOf(this.lines, () => this.data.exact, this.along), axes: axes(right && right.scale),
      hooks: {
        drawClear: [chart => this.shade(chart)],
        setSelect: [chart => {
          if (chart.select.width < 3) return;
          const from = chart.posToVal(chart.select.left, "x"), to = chart.posToVal(chart.select.left + chart.select.width, "x");
          chart.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
          if (!(this.onmark && this.onmark(from, to))) this.together.show(from, to);
        }],
      },
    }, [this.data.time, ...this.data.columns], this.place);
    this.chart.over.addEventListener("dblclick", () => this.together.move("all"));
    if (this.together.whole) this.put();
  }
  shade(chart) {
    if (!this.bands) return;
    const {ctx, bbox} = chart, clamp = x => Math.max(bbox.left, Math.min(bbox.left + bbox.width, x));
    ctx.save();
    for (const band of this.bands()) {
      const left = clamp(chart.valToPos(band.start, "x", true)), right = clamp(chart.valToPos(band.end, "x", true));
      ctx.fillStyle = colour(`${band.role}-band`);
      ctx.fillRect(left, bbox.top, right - left, bbox.height);
      ctx.fillStyle = colour(band.role);
      ctx.fillRect(left, bbox.top, right - left, 4 * devicePixelRatio);
    }
    ctx.restore();
  }
  redraw() { if (this.chart) this.chart.redraw(false); }
  dispose() { if (this.asked) this.asked.abort(); this.together.plots.delete(this); super.dispose(); }
}

export function legendOf(drawn) { // one for several charts
  const lines = new Map(drawn.map(line => [line.name, line.role]));
  return h("div", {className: "legend"}, [...lines].map(([name, role]) => {
    const sign = h("i", {className: {paper: "dashed", hold: "dotted"}[role]});
    sign.style.borderColor = `var(--${role})`;
    return h("span", {}, sign, name);
  }));
}

function floats(text) {
  const raw = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  return Array.from(new Float32Array(raw.buffer), v => Number.isNaN(v) ? null : v);
}

export class DrawnChart extends Sized {
  constructor(place, chart, {height = 190, key = null, group = null, legend = true} = {}) {
    super(place);
    Object.assign(this, {spec: chart, height, key, group, legend});
    this.numbers = [floats(chart.x), ...chart.lines.map(line => floats(line.y))];
    place.classList.add("plot");
    place.setAttribute("role", "img");
    place.setAttribute("aria-label", chart.summary);
    if (group) group.add(this);
    this.rebuild();
  }
  rebuild() {
    if (!this.place.clientWidth) return;
    if (this.chart) this.chart.destroy();
    const {spec} = this;
    this.chart = new uPlot({
      width: this.place.clientWidth, height: this.height, padding: [8, 12, 0, 0],
      scales: {x: {time: false}, y: {...(spec.y_log ? {distr: 3} : {}), ...(spec.y_range ? {range: () => spec.y_log ? uPlot.rangeLog(...spec.y_range, 10, false) : spec.y_range} : {})}},
      cursor: {y: false, drag: {x: true, y: false}, points: {size: 5}, ...(this.key ? {sync: {key: this.key}} : {})},
      legend: {show: this.legend},
      series: seriesOf(spec.lines, () => true).map((one, i) => i ? one : {label: spec.x_label.split(" [")[0], value: (_, v) => number(v)}),
      axes: axes(),
      hooks: {
        drawClear: [chart => this.mark(chart)],
        setScale: [(chart, scale) => { if (scale === "x" && this.group && !this.spreading && chart.status) this.spread(chart.scales.x); }],
      },
    }, this.numbers, this.place);
  }
  spread({min, max}) {
    for (const other of this.group) {
      if (other === this || !other.chart) continue;
      other.spreading = true;
      other.chart.setScale("x", {min, max});
      other.spreading = false;
    }
  }
  mark(chart) {
    const {ctx, bbox} = chart, {spec} = this;
    ctx.save();
    if (spec.span) {
      const [low, high] = spec.span.map((end, i) => end === null ? bbox.left + i * bbox.width : chart.valToPos(end, "x", true));
      ctx.fillStyle = colour("shade");
      ctx.fillRect(Math.max(low, bbox.left), bbox.top, Math.min(high, bbox.left + bbox.width) - Math.max(low, bbox.left), bbox.height);
    }
    ctx.strokeStyle = colour("muted");
    ctx.setLineDash([5, 4]);
    for (const [level] of spec.levels) {
      const y = chart.valToPos(level, "y", true);
      ctx.beginPath(); ctx.moveTo(bbox.left, y); ctx.lineTo(bbox.left + bbox.width, y); ctx.stroke();
    }
    ctx.restore();
  }
}
