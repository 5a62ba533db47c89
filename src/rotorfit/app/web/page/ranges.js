// Step 3: which stretches train the model, and which prove it.

import {get} from "./api.js";
import {fill, h, labelled, motionUnits, options, seconds} from "./dom.js";
import {told} from "./logs.js";
import {Together, WindowPlot} from "./plot.js";

const ROLES = [["train", "training"], ["validate", "validation"]];

export function rangesPanel(place, studio) {
  const body = h("div", {className: "stack"});
  fill(place, h("h1", {id: "ranges-title"}, "Ranges"),
    h("p", {className: "lead"}, "Mark what the model is fitted to, and what it must prove itself on. Nothing outside a range is seen."), body);
  const blocks = new Map(); // log -> its block
  let card = null;

  function draw({session}) {
    if (card !== session.card_revision) { card = session.card_revision; for (const block of blocks.values()) block.element.remove(); blocks.clear(); }
    const ids = session.uploads.map(one => one.id);
    for (const [id, block] of blocks) if (!ids.includes(id)) { block.element.remove(); blocks.delete(id); }
    for (const log of session.uploads) {
      if (!blocks.has(log.id)) { blocks.set(log.id, rangeBlock(log, studio)); body.append(blocks.get(log.id).element); }
      blocks.get(log.id).draw(log);
    }
    if (!session.uploads.length) fill(body, h("p", {className: "empty"}, "No log yet. ", h("a", {href: "#logs"}, "Add one")));
    else if (!body.querySelector(".next")) body.append(h("p", {className: "next"}, h("a", {className: "button primary", href: "#fit"}, "Next: fit")));
    const next = body.querySelector(".next");
    if (next && next !== body.lastChild) body.append(next);
    for (const empty of body.querySelectorAll(".empty")) if (session.uploads.length) empty.remove();
  }
  return {draw};
}

function rangeBlock(first, studio) {
  let log = first, span = null, commands = {}, drawn = null, plot = null;
  const together = new Together(), list = h("ul", {className: "ranges"}), canvas = h("div", {}), state = h("span", {className: "muted"});
  const what = h("select", {onchange: () => show()}), drag = h("select", {});
  options(drag, [["train", "marks training"], ["validate", "marks validation"], ["zoom", "zooms"]], first.ranges.length && first.ranges[0].role === "validate" ? "validate" : "train");
  const quick = (words, ranges) => h("button", {type: "button", onclick: () => put(ranges())}, words);
  const cut = () => span[0] + Math.round(7 * (span[1] - span[0])) / 10;
  const tools = h("div", {className: "bar", hidden: true},
    labelled("Axis", what, "field inline"), labelled("Dragging", drag, "field inline"), together.tools(),
    h("div", {className: "tools"},
      quick("All training", () => [{role: "train", start: null, end: null}]), quick("All validation", () => [{role: "validate", start: null, end: null}]),
      quick("Split 70 : 30", () => [{role: "train", start: null, end: cut()}, {role: "validate", start: cut(), end: null}]), quick("Use nothing", () => [])));
  const element = h("article", {className: "panel", "data-log": first.id}, h("h2", {}, first.name), state, tools, canvas, list);
  const put = ranges => studio.change("PUT", `/api/logs/${log.id}/ranges`, {ranges, seen: log.revision}, rows); // a refused number does not stay in its box
  const closed = one => ({role: one.role, start: one.start ?? span[0], end: one.end ?? span[1]});

  async function load() {
    if (!studio.session.card) { state.textContent = "A card is being drafted …"; return; }
    try {
      const flight = await get(`/api/logs/${log.id}/flight`);
      span = flight.span;
      commands = flight.commands_in;
      options(what, flight.axes.map(axis => [axis, axis]), flight.axes[0]);
      tools.hidden = false;
      show();
      rows();
    } catch (error) { fill(state, error.message, " ", h("a", {href: "#card"}, "See the card")); state.className = "notice error"; }
  }

  function show() {
    if (plot) plot.dispose();
    fill(canvas);
    const inner = h("div", {});
    canvas.append(h("p", {className: "muted"}, h("strong", {}, what.value), motionUnits(what.value, commands)), inner);
    plot = new WindowPlot(inner, {
      path: `/api/logs/${log.id}/motion?axis=${what.value}`, together, height: 200, label: `Command and velocity ${what.value} of ${log.name}`,
      lines: [{name: "command", role: "command", scale: "command", stepped: true}, {name: "velocity", role: "measured"}],
      bands: () => span ? log.ranges.map(closed) : [],
      onmark: (from, to) => { if (drag.value === "zoom") return false; mark(drag.value, from, to); return true; },
      onloaded: data => { state.textContent = `${seconds(span[1] - span[0])} s of flight; ${told(data)}`; },
      onerror: error => { state.textContent = error.message; },
    });
  }

  function mark(role, from, to) { // a new range takes its place from those that it lies on
    const start = Math.max(span[0], Math.round(100 * from) / 100), end = Math.min(span[1], Math.round(100 * to) / 100);
    if (end - start < 0.05) return;
    const rest = log.ranges.map(closed).flatMap(one => [{...one, end: Math.min(one.end, start)}, {...one, start: Math.max(one.start, end)}]).filter(one => one.end - one.start > 0.05);
    const whole = log.ranges.length === 1 && log.ranges[0].start === null && log.ranges[0].end === null && log.ranges[0].role === role;
    const ranges = [...(whole ? [] : rest), {role, start, end}].sort((a, b) => a.start - b.start);
    put(ranges);
  }

  function rows() {
    fill(list, log.ranges.map((range, i) => {
      const changed = part => put(log.ranges.map((one, k) => k === i ? {...one, ...part} : one));
      const role = h("select", {"aria-label": "Use", onchange: () => changed({role: role.value})});
      options(role, ROLES, range.role);
      const end = (name, words, blank) => {
        const input = h("input", {type: "number", step: "any", "aria-label": `${words} in seconds`, placeholder: blank,
          onchange: () => changed({[name]: input.value === "" ? null : Number(input.value)})});
        input.value = seconds(range[name]);
        return input;
      };
      return h("li", {className: range.role}, role, " from ", end("start", "From", "start"), " to ", end("end", "To", "end"), " s ",
        h("button", {type: "button", className: "close", "aria-label": "Remove this range", onclick: () => put(log.ranges.filter((_, k) => k !== i))}, "×"));
    }), h("li", {}, h("button", {type: "button", onclick: () => put([...log.ranges, {role: drag.value === "validate" ? "validate" : "train", start: null, end: null}])}, "Add a range by numbers")));
    if (plot) plot.redraw();
  }

  load();
  return {element, draw(now) { if (drawn !== now.revision) { log = now; drawn = now.revision; if (span) rows(); } else log = now; }};
}
