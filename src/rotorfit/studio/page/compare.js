// Step 5: several models on the stretches for validation, side by side, and whether the differences are real.

import {get} from "./api.js";
import {fill, h, labelled, options} from "./dom.js";
import {title} from "./fit.js";

const HORIZONS = [["0.5", "0.5 s"], ["1", "1 s"], ["2", "2 s"], ["5", "5 s"]];

export function comparePanel(place, studio) {
  const boxes = h("fieldset", {className: "models"}), start = h("button", {type: "button", className: "primary", onclick: () => begin()}, "Compare");
  const lack = h("p", {className: "muted"}), progress = h("p", {className: "muted", "aria-live": "polite"}), horizon = options(h("select", {onchange: () => table()}), HORIZONS, "1"), result = h("div", {});
  fill(place, h("h1", {id: "compare-title"}, "Compare"), h("p", {className: "lead"}, "Models side by side, on the stretches that are marked for validation."),
    h("div", {className: "panel"}, boxes, progress, h("div", {className: "bar"}, start, lack)), result);
  let drawn = null, shown = null, found = null;
  const chosen = new Set();

  function begin() { studio.change("POST", "/api/fits", {compare: [...boxes.querySelectorAll("input:checked")].map(one => one.value)}); }

  function table() {
    if (!found) { fill(result); return; }
    const rows = found.rows.filter(row => row.horizon === Number(horizon.value));
    const cells = (row, what) => {
      const best = Math.min(...row[what].filter(one => one !== null)), factor = row.axis === "yaw" ? 180 / Math.PI : 100;
      return row[what].map((one, i) => h("td", {className: `number ${one === best ? "strong" : ""}`}, one === null ? "–" : (factor * one).toPrecision(3), row.fitted[i] ? h("abbr", {title: "fitted to part of this stretch: proves nothing"}, " *") : null));
    };
    const heads = what => found.columns.map(name => h("th", {className: "number", title: what}, name));
    fill(result, h("article", {className: "panel"}, h("div", {className: "bar"}, h("h2", {}, title(shown)), labelled("Ahead", horizon, "field inline")),
      h("div", {className: "scroll"}, h("table", {}, h("thead", {},
        h("tr", {}, h("th", {colSpan: 2}), h("th", {colSpan: found.columns.length}, "Velocity RMSE [cm/s, yaw deg/s]"), h("th", {colSpan: found.columns.length}, "Position RMSE [cm, yaw deg]"), h("th", {})),
        h("tr", {}, h("th", {}, "Stretch"), h("th", {}, "Axis"), heads("velocity"), heads("position"), h("th", {className: "number"}, "n"))),
      h("tbody", {}, rows.map((row, i) => h("tr", {}, h("td", {}, i && stretch(rows[i - 1]) === stretch(row) ? "" : stretch(row)), h("td", {}, row.axis), cells(row, "velocity"), cells(row, "position"), h("td", {className: "number"}, String(row.n))))))),
      h("p", {className: "muted"}, "Bold: the smallest. hold keeps the velocity of the start; paper uses the paper's coefficients. * fitted to part of this stretch."),
      paired(), found.notes.map(note => h("p", {className: "muted"}, note))));
  }

  function paired() {
    const lines = found.paired.flatMap(test => Object.entries(test.axes).flatMap(([axis, horizons]) => {
      const one = horizons[horizon.value] && horizons[horizon.value].velocity.pooled, factor = axis === "yaw" ? 180 / Math.PI : 100;
      if (!one) return [];
      const error = one.rmse_stderr === null ? "" : ` ± ${(factor * one.rmse_stderr).toPrecision(2)}`;
      return [h("tr", {}, h("td", {}, `${test.first} against ${test.second}`), h("td", {}, axis), h("td", {className: "number"}, `${(factor * one.rmse).toPrecision(3)}${error}`), h("td", {}, one.verdict.replaceAll("_", " ")))];
    }));
    if (!lines.length) return null;
    return [h("h3", {}, "Is the difference real?"), h("div", {className: "scroll"}, h("table", {}, h("thead", {}, h("tr", {}, h("th", {}, "Models"), h("th", {}, "Axis"), h("th", {className: "number"}, "Difference of the velocity RMSE"), h("th", {}, "Verdict at 95 %"))), h("tbody", {}, lines)))];
  }

  const stretch = row => `${row.path}, ${row.span.map(one => one.toFixed(1)).join(" to ")} s`;

  async function load(fit) {
    try { found = await get(`/api/fits/${fit.id}/result.json`); } catch (error) { found = null; fill(result, h("p", {className: "notice error"}, error.message)); return; }
    if (shown === fit) table();
  }

  function draw({session}) {
    const models = session.fits.filter(one => one.settings.kind === "fit" && one.status === "done");
    const comparisons = session.fits.filter(one => one.settings.kind === "compare"), last = comparisons[comparisons.length - 1] || null;
    const some = session.uploads.some(log => log.ranges.some(one => one.role === "validate"));
    start.disabled = !models.length || !some || Boolean(session.running);
    lack.textContent = !models.length ? "Fit a model first." : !some ? "Mark a stretch for validation first." : "";
    progress.textContent = session.running && comparisons.some(one => one.id === session.running.id) ? `${Math.round(100 * session.running.fraction)} %: ${session.running.text}` : "";
    if (drawn === session.revision) return;
    drawn = session.revision;
    for (const box of boxes.querySelectorAll("input")) if (box.checked) chosen.add(box.value); else chosen.delete(box.value);
    const fresh = models.filter(one => !boxes.querySelector(`input[value="${one.id}"]`));
    for (const one of fresh) chosen.add(one.id);
    fill(boxes, h("legend", {}, "Models"), models.map(one => {
      const box = h("input", {type: "checkbox", id: `model-${one.id}`, value: one.id, checked: chosen.has(one.id)});
      return h("label", {className: "check", for: box.id}, box, title(one), h("span", {className: "muted"}, ` ${one.settings.method}, ${one.settings.structure.replaceAll("_", " ")}, ${one.settings.axes.join(" ")}`));
    }), models.length ? null : h("p", {className: "muted"}, "None yet."));
    if (!last) { fill(result); return; }
    if (last.status === "done" && (!shown || shown.id !== last.id)) { shown = last; load(last); }
    if (last.status === "failed") { shown = null; fill(result, h("p", {className: "notice error"}, last.text)); }
  }
  return {draw};
}
