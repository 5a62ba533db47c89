// The live page: states come as server-sent events, and are drawn as they come. Nothing is asked and nothing is sent.
"use strict";
if (location.search) history.replaceState(null, "", location.pathname); // the key stays in the cookie

const KEPT = 3600;
const AXES = ["x", "y", "z", "yaw"];
const QUANTITIES = [["input", "{}/s²"], ["damping", "1/s"], ["delay", "s"], ["wind", "{}/s²"]]; // as charts, in the unit of length or angle
const REST = [["lag", "s"], ["zero", "s"], ["steady_gain", "{}/s"], ["total_lag", "s"]]; // as text
const WIDEST = 6; // a chart is not scaled to intervals so many times as wide as their median: some seconds know little
const place = id => document.getElementById(id);
const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const figure = value => Number(value).toPrecision(3);
const unitOf = (unit, axis) => unit.replace("{}", axis === "yaw" ? "rad" : "m");
const missing = value => value === null || value === undefined;
const time = [], alarms = [], raised = new Map(), panels = new Map();

function made(tag, kind, text) {
  const node = document.createElement(tag);
  if (kind) node.className = kind;
  if (text !== undefined) node.textContent = text;
  return node;
}

function faded(text, share) { // #rrggbb with an opacity
  return `${text}${Math.round(255 * share).toString(16).padStart(2, "0")}`;
}

function rounded(low, high) { // to two digits of half the interval: further ones mean nothing
  if (missing(low) || missing(high) || !(high > low)) return figure;
  const decimals = Math.min(Math.max(1 - Math.floor(Math.log10((high - low) / 2) + 1e-9), 0), 9);
  return value => (Number(value.toFixed(decimals)) || 0).toFixed(decimals); // no minus before a zero
}

function between(low, high) { // an interval in words; an end that is open is left out
  if (missing(low)) return missing(high) ? "" : `below ${figure(high)}`;
  return missing(high) ? `above ${figure(low)}` : [low, high].map(rounded(low, high)).join(" to ");
}

function told(value, [low, high], unit = "") { // a number with its interval
  const range = between(low, high), behind = unit && ` ${unit}`;
  if (missing(value)) return range ? `${range}${behind}` : "unknown";
  return `${rounded(low, high)(value)}${behind}${range && ` (${range})`}`;
}

function quantile(values, share) {
  return [...values].sort((a, b) => a - b)[Math.round(share * (values.length - 1))];
}

function reach([value, low, high]) { // intervals of usual width, what was said, and where it has been lately
  const said = value.filter(one => one !== null);
  const whole = [...value.keys()].filter(k => low[k] !== null && high[k] !== null), wide = k => high[k] - low[k];
  const usual = quantile(whole.map(wide), 0.5), kept = whole.filter(k => wide(k) <= WIDEST * usual);
  const all = kept.flatMap(k => [low[k], high[k]]);
  if (said.length) all.push(quantile(said, 0.02), quantile(said, 0.98), quantile(said.slice(-9), 0.5));
  if (!all.length) return [null, null]; // no scale where nothing was said
  const least = Math.min(...all), most = Math.max(...all), room = 0.1 * (most - least) || 0.1 * Math.abs(most) || 0.1;
  return [least - room, most + room];
}

function chart(holder, series, role) {
  const line = colour(role), muted = colour("muted"), grid = {stroke: colour("line"), width: 1};
  const axis = {stroke: muted, grid, ticks: grid, font: "10px system-ui, sans-serif"};
  const marks = u => {
    const {ctx, bbox} = u;
    ctx.save();
    ctx.strokeStyle = colour("alarm"); ctx.lineWidth = 1.5; ctx.setLineDash([4, 3]);
    for (const at of alarms) {
      const x = u.valToPos(at, "x", true);
      if (x < bbox.left || x > bbox.left + bbox.width) continue;
      ctx.beginPath(); ctx.moveTo(x, bbox.top); ctx.lineTo(x, bbox.top + bbox.height); ctx.stroke();
    }
    ctx.restore();
  };
  const edge = {stroke: faded(line, 0.35), width: 1, points: {show: false}};
  return new uPlot({
    width: holder.clientWidth || 300, height: 120, legend: {show: false}, cursor: {show: false},
    scales: {x: {time: false}, y: {range: () => reach(series)}},
    axes: [{...axis, size: 24, space: 60}, {...axis, size: 46, space: 24}],
    series: [{}, {stroke: line, width: 1.8, points: {show: false}}, edge, edge],
    bands: [{series: [3, 2], fill: faded(line, 0.15)}],
    hooks: {draw: [marks]},
  }, [time, ...series], holder);
}

function panel(name) {
  const box = made("section", "axis"), head = made("h2"), charts = made("div", "charts");
  const state = made("span", "state"), now = made("span", "now"), rest = made("p", "rest"), parts = {};
  head.append(made("span", "", name), state, now);
  box.append(head, charts, rest);
  place("axes").append(box);
  for (const [quantity, unit] of QUANTITIES) {
    const frame = made("figure"), caption = made("figcaption"), said = made("span"), holder = made("div");
    caption.append(made("b", "", `${quantity} [${unitOf(unit, name)}]`), said);
    frame.append(caption, holder);
    charts.append(frame);
    const series = [[], [], []];
    for (const one of series) while (one.length < time.length) one.push(null);
    parts[quantity] = {series, said, holder, chart: null};
  }
  panels.set(name, {state, now, rest, parts});
  return panels.get(name);
}

function worded(text) {
  if (text.startsWith("known")) return "known";
  if (text.startsWith("changed")) return /s, known( |$)/.test(text) ? "known" : "changed";
  return text.startsWith("learning") ? "learning" : text.startsWith("holding") ? "holding" : "unknown";
}

function taken(state) {
  time.push(state.time);
  const names = AXES.filter(name => state.axes[name] || panels.has(name));
  for (const name of names) {
    const axis = state.axes[name] || {state: "–", ci95: {}}, one = panels.get(name) || panel(name);
    one.state.textContent = axis.state;
    one.state.className = `state ${worded(axis.state)}`;
    const speed = unitOf("{}/s", name);
    one.now.textContent = [missing(axis.velocity) ? "" : `velocity ${figure(axis.velocity)} ${speed}`,
      axis.gusts ? `gusts ${figure(axis.gusts)} ${speed}` : "", axis.structure ? axis.structure.replaceAll("_", " ") : "",
      axis.untested > 0.5 ? "hardly watched: x and y are commanded hard" : missing(axis.watched_from) ? "not yet watched for changes"
        : `watched for changes from ${axis.watched_from.toFixed(2)} s on`].filter(Boolean).join(" · ");
    one.rest.textContent = REST.filter(([quantity]) => !missing(axis[quantity]))
      .map(([quantity, unit]) => `${quantity.replace("_", " ")} ${told(axis[quantity], axis.ci95[quantity] || [], unitOf(unit, name))}`).join(" · ");
    for (const [quantity] of QUANTITIES) {
      const {series, said} = one.parts[quantity];
      const ends = (quantity === "wind" ? axis.wind_ci95 : axis.ci95[quantity]) || [null, null], value = axis[quantity] ?? null;
      const drawn = axis.from && quantity !== "wind" ? [null, null, null] : [value, ...ends]; // a chart shows what this flight told
      if (series[0].length < time.length) for (const part of [0, 1, 2]) series[part].push(drawn[part]);
      said.textContent = told(value, ends);
    }
  }
  while (time.length > KEPT) {
    time.shift();
    for (const one of panels.values()) for (const part of Object.values(one.parts)) for (const values of part.series) values.shift();
  }
  place("time").textContent = `${state.time.toFixed(0)} s`;
  place("regime").textContent = state.regime ? `vehicle ${state.regime + 1} of this flight` : "";
}

function noted(box) {
  place("notes").prepend(box);
  while (place("notes").children.length > 20) place("notes").lastChild.remove();
}

function alarmed(alarm) { // a revision takes the place of its alarm
  const before = alarm.revises === null ? undefined : raised.get(alarm.revises);
  if (before) { alarms[before.number] = alarm.since[0]; before.box.remove(); }
  const number = before ? before.number : alarms.push(alarm.since[0]) - 1;
  const box = made("div", "alarm"), head = made("div");
  head.append(made("b", "", `${alarm.cause.replaceAll("_", " ")}`), ` on ${alarm.axes.join(", ")}, raised at ${(alarm.revises ?? alarm.time).toFixed(2)} s, since ${alarm.since[0].toFixed(1)} to ${alarm.since[1].toFixed(1)} s`);
  const changes = Object.entries(alarm.change).map(([name, [low, high]]) => {
    const [axis, what] = name.split("."), times = ["delay", "lag", "zero", "total_lag"].includes(what);
    const ratio = ["input", "damping", "lag", "level", "steady_gain"].includes(what) && !(times && alarm.cause === "another_vehicle");
    const unit = ratio ? "" : what === "trim" ? unitOf("{}/s²", axis) : times ? "s" : "";
    return `${axis} ${what.replaceAll("_", " ")} ${ratio ? "times" : "by"} ${between(low, high)}${unit && ` ${unit}`}`;
  });
  box.append(head, made("p", "", `${alarm.why}.${changes.length ? ` ${changes.join("; ")}.` : ""}`));
  const named = {...Object.fromEntries(alarm.axes.map(axis => [axis, alarm.time])), ...before?.named}; // when first
  raised.set(alarm.revises ?? alarm.time, {box, number, alarm, named});
  noted(box);
  outdated();
}

const regains = [];
function outdated() { // marks gains of before an alarm
  const after = [...raised.values()].filter(one => !one.alarm.cause.startsWith("pose"));
  for (const {message, box, mark} of regains) {
    const names = Object.keys(message.axes);
    const told = ({alarm, named}, name) => alarm.cause === "another_vehicle" ? alarm.time : alarm.axes.includes(name) ? named[name] : -1;
    const old = names.filter(name => after.some(one => told(one, name) > message.time));
    mark.textContent = old.length ? `; of before the alarm: ${old.join(", ")}` : "";
    box.classList.toggle("old", old.length === names.length);
  }
}

function regained(message) {
  const box = made("div", "gains"), head = made("div"), mark = made("span"), names = Object.keys(message.axes);
  head.append(made("b", "", "new gains"), ` for ${names.join(", ")}, at ${message.time.toFixed(1)} s${message.file ? `, in ${message.file}` : ""}`);
  head.append(mark);
  box.append(head);
  for (const name of names) {
    const {bandwidth, stiffness, rate_gain} = message.axes[name];
    box.append(made("p", "", `${name}: bandwidth ${figure(bandwidth)} rad/s, stiffness ${figure(stiffness)} 1/s², rate ${figure(rate_gain)} 1/s: ${message.why[name]}.`));
  }
  regains.push({message, box, mark});
  noted(box);
  outdated();
}

let due = false;
function drawn() { // once a frame at the most, however many states come at once
  due = false;
  for (const one of panels.values()) {
    for (const [quantity, part] of Object.entries(one.parts)) {
      if (!part.chart) part.chart = chart(part.holder, part.series, quantity === "wind" ? "wind" : "value");
      else if (part.chart.width !== part.holder.clientWidth && part.holder.clientWidth) part.chart.setSize({width: part.holder.clientWidth, height: 120});
      part.chart.setData([time, ...part.series]);
    }
  }
}
function draw() { if (!due) { due = true; requestAnimationFrame(drawn); } }

let last = 0;
function linked(text, gone) { place("link").textContent = text; place("link").className = gone ? "gone" : ""; }
const source = new EventSource("events");
source.onmessage = event => {
  const line = JSON.parse(event.data);
  last = Date.now();
  linked("", false);
  ({alarm: alarmed, gains: regained, state: taken})[line.type]?.(line);
  draw();
};
source.addEventListener("vehicle", event => {
  const name = JSON.parse(event.data);
  place("vehicle").textContent = name;
  document.title = name ? `${name} – rotorfit live` : "rotorfit live";
});
source.addEventListener("over", () => { linked("ended", false); source.close(); });
source.onerror = () => { if (source.readyState !== EventSource.CLOSED) linked("not connected: trying again", true); };
setInterval(() => { if (last && source.readyState === EventSource.OPEN && Date.now() - last > 4000) linked(`nothing new for ${Math.round((Date.now() - last) / 1000)} s`, true); }, 1000);
addEventListener("resize", draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const one of panels.values()) for (const part of Object.values(one.parts)) if (part.chart) { part.chart.destroy(); part.chart = null; }
  draw();
});
