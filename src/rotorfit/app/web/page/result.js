// What came of a fit: verdict, coefficients, proof, findings, and the files to keep.

import {file} from "./api.js";
import {fill, findingList, h, labelled, notice, options, wide} from "./dom.js";
import {DrawnChart, legendOf} from "./plot.js";

const SCORES = ["Flight", "Axis", "Ahead", "Velocity: model", "paper", "hold", "Position: model", "paper", "hold", "n"];
const RESIDUALS = ["Flight", "Axis", "Whiteness", "Statistic, lags", "Past commands", "Variance", "Optimism"];
const OPEN = 2; // flights that are unfolded from the start

export function resultView(fit, found, {exports, untold}) {
  const place = name => `/api/fits/${fit.id}/${name}`;
  const validation = found.flights.filter(one => one.role === "validation"), training = found.flights.filter(one => one.role === "training");
  return [
    h("article", {className: "panel verdict"},
      h("p", {className: "muted question"}, `Can I use this model for a controller that looks ${found.horizon} s ahead?`),
      h("h2", {className: "headline"}, found.headline),
      h("div", {className: "lights"}, found.lights.map(light => h("div", {className: `light ${light.colour}`},
        h("h3", {}, light.axis, h("span", {className: "word"}, light.word)),
        light.error ? h("p", {className: "error-figure"}, h("strong", {}, light.error), ` off, ${found.horizon} s ahead`) : null,
        light.sentences.map(line => h("p", {}, line)),
        h("ul", {className: "lamps"}, light.lamps.map(lamp => h("li", {className: lamp.colour}, h("strong", {}, lamp.question), " ", h("span", {className: "word"}, lamp.word), lamp.colour === "green" ? null : h("p", {className: "muted"}, lamp.text))))))),
      found.left_out?.length ? h("div", {className: "notice warning"}, h("div", {}, h("p", {}, "Left out, as nothing can be proved on them:"), h("ul", {}, found.left_out.map(line => h("li", {}, line))))) : null,
      h("p", {}, found.whole),
      h("p", {className: "muted"}, found.summary),
      h("div", {className: "bar downloads"},
        h("a", {className: "button primary", href: place("report.html"), target: "_blank", rel: "noopener"}, "Open the report"),
        h("a", {className: "button", href: `${place("model.json")}?download`, download: `model-${fit.id}.json`}, "Download model"),
        h("a", {className: "button", href: `${place("report.html")}?download`, download: `report-${fit.id}.html`}, "Download report"),
        validation.length ? h("a", {className: "button", href: `${place("validation.json")}?download`, download: `validation-${fit.id}.json`}, "Download scores") : null, exporter(fit, exports, untold))),
    h("article", {className: "panel"}, h("h2", {}, "Coefficients"), coefficients(found.coefficients)),
    validation.length ? h("article", {className: "panel"}, h("h2", {}, "Predicted and measured, on flights that were not fitted"),
      h("p", {className: "muted"}, validation[0].charts.length ? validation[0].charts[0].reading : ""), validation.map((one, i) => i < OPEN ? flight(one, `${fit.id}-v${i}`)
        : h("details", {}, h("summary", {}, one.path, h("span", {className: "muted"}, ` · ${one.duration.toFixed(1)} s`)), lazily(() => flight(one, `${fit.id}-v${i}`))))) : null,
    found.horizons.length ? h("article", {className: "panel"}, h("h2", {}, "How far ahead"), h("p", {className: "muted"}, found.horizons[0].reading),
      legendOf(found.horizons.flatMap(chart => chart.lines)), h("div", {className: "multiples"}, found.horizons.map(chart => small(chart))), scores(found)) : null,
    h("article", {className: "panel"}, h("h2", {}, "Findings"), findingList(found.findings, "Nothing to tell.")),
    h("details", {className: "panel"}, h("summary", {}, h("h2", {}, "Training flights")), lazily(() => training.map((one, i) => flight(one, `${fit.id}-t${i}`)))),
    found.profiles.length ? h("details", {className: "panel"}, h("summary", {}, h("h2", {}, "Why this delay")), lazily(() => [h("p", {className: "muted"}, found.profiles[0].reading), h("div", {className: "multiples"}, found.profiles.map(chart => small(chart)))])) : null,
    found.residuals.length ? h("details", {className: "panel"}, h("summary", {}, h("h2", {}, "What the residuals say")), grid(RESIDUALS, found.residuals, 2)) : null,
    h("details", {className: "panel"}, h("summary", {}, h("h2", {}, "Repairs of the logs")), found.notes.map(one => [h("h3", {}, `${one.path}, ${one.span.map(v => v.toFixed(2)).join(" to ")} s`), h("ul", {}, one.texts.map(text => h("li", {}, text)))])),
  ];
}

function exporter(fit, formats, untold) { // a refusal is one line, so it is asked for by script and not by a link
  const select = options(h("select", {}), Object.entries(formats).map(([name, words]) => [name, `${name}: ${words}`]), "numpy");
  const also = h("input", {type: "checkbox", id: `untold-${fit.id}`});
  let told = null;
  const save = async () => {
    told?.remove();
    try {
      const {blob, name} = await file(`/api/fits/${fit.id}/exports/${encodeURIComponent(select.value)}${also.checked ? "?predictor" : ""}`);
      const link = h("a", {href: URL.createObjectURL(blob), download: name});
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    } catch (error) { told = notice("error", error.message); }
  };
  return h("div", {className: "bar export"}, labelled("For", select, "field inline"), h("label", {className: "check", for: also.id, title: "by the point that predicts best; its single coefficients may be far off"}, also, untold), h("button", {type: "button", onclick: save}, "Export"));
}

function lazily(make) { // charts have no width before they are shown
  const place = h("div", {});
  const seen = new IntersectionObserver(entries => { if (entries.some(one => one.isIntersecting)) { seen.disconnect(); fill(place, make()); } });
  seen.observe(place);
  place.append(h("p", {className: "muted"}, "…"));
  return place;
}

function coefficients(axes) {
  return wide(h("table", {className: "coefficients"},
    h("thead", {}, h("tr", {}, ["Axis", "Coefficient", "Estimate", "95 % interval", "◇ paper", "Unit", "Status", "Paper"].map((head, i) => h("th", {className: [2, 7].includes(i) ? "number" : ""}, head)))),
    axes.map(({axis, rows}) => h("tbody", {}, rows.map((row, i) => h("tr", {className: row.kind},
      h("th", {}, i ? "" : axis), h("td", {}, row.term), h("td", {className: "number strong"}, row.value), h("td", {}, row.interval), h("td", {className: "bar-cell"}, interval(row.bar)),
      h("td", {className: "muted"}, row.unit), h("td", {className: `status ${row.kind}`}, row.kind === "combination" ? "" : row.status), h("td", {className: "number muted"}, row.paper)))))));
}

function interval(bar) { // a picture of the interval, its estimate, and the paper's value
  if (!bar) return null;
  const at = one => 4 + 1.12 * one;
  const svg = (tag, attributes) => { const one = document.createElementNS("http://www.w3.org/2000/svg", tag); for (const [name, set] of Object.entries(attributes)) one.setAttribute(name, set); return one; };
  const picture = svg("svg", {viewBox: "0 0 120 18", width: 120, height: 18, "aria-hidden": "true"});
  picture.append(svg("line", {x1: at(bar.low), x2: at(bar.high), y1: 9, y2: 9, class: "range"}));
  if (bar.paper !== null) { const x = at(bar.paper); picture.append(svg("path", {d: `M${x} 4.5 L${x + 4.5} 9 L${x} 13.5 L${x - 4.5} 9 Z`, class: "diamond"})); }
  if (bar.value !== null) picture.append(svg("circle", {cx: at(bar.value), cy: 9, r: 3.6, class: "estimate"}));
  return picture;
}

function flight(view, key) {
  const group = new Set();
  return h("div", {className: "flight"}, h("h3", {}, view.path, h("span", {className: "muted"}, ` · ${view.duration.toFixed(1)} s`)),
    view.missing.length ? h("p", {className: "muted"}, `No model of ${view.missing.join(", ")}.`) : null,
    h("div", {className: "motions"}, view.charts.map(chart => {
      const canvas = h("div", {});
      requestAnimationFrame(() => new DrawnChart(canvas, chart, {height: 180, key, group}));
      return h("figure", {}, h("figcaption", {}, h("strong", {}, chart.title), h("span", {className: "muted"}, ` [${chart.y_label}]`)), canvas, h("p", {className: "seen"}, chart.summary));
    })), h("p", {className: "seen"}, `${view.drawn} Drag to zoom, double-click shows all.`));
}

function small(chart) {
  const canvas = h("div", {});
  requestAnimationFrame(() => new DrawnChart(canvas, chart, {height: 180, legend: false}));
  return h("figure", {}, h("figcaption", {}, h("strong", {}, chart.title), h("span", {className: "muted"}, ` ${chart.y_label} over ${chart.x_label}`)), canvas);
}

function scores(found) {
  const known = rows => rows.filter(row => row[3] !== "—");
  return [grid(SCORES.slice(1), known(found.pooled).map(row => row.slice(1)), 2),
    found.scores.length ? h("details", {}, h("summary", {}, "Flight by flight"), grid(SCORES, known(found.scores), 3)) : null];
}

export function grid(heads, rows, left) {
  return wide(h("table", {}, h("thead", {}, h("tr", {}, heads.map((head, i) => h("th", {className: i >= left ? "number" : ""}, head)))),
    h("tbody", {}, rows.map(row => h("tr", {}, row.map((cell, i) => h("td", {className: i >= left ? "number" : ""}, cell)))))));
}
