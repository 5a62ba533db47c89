// Step 5: several models on the stretches for validation, side by side, and whether the differences are real.

import {get} from "./api.js";
import {fill, h, labelled, options, wide} from "./dom.js";
import {changed, madeOf, title} from "./fit.js";

const HORIZONS = [["0.5", "0.5 s"], ["1", "1 s"], ["2", "2 s"], ["5", "5 s"]];

const shownAs = axis => axis === "yaw" ? {factor: 180 / Math.PI, unit: "deg/s"} : {factor: 100, unit: "cm/s"};

export function comparePanel(place, studio) {
  const boxes = h("fieldset", {className: "models"}), start = h("button", {type: "button", className: "primary", onclick: () => begin()}, "Compare");
  const lack = h("p", {className: "muted"}), progress = h("p", {className: "muted", "aria-live": "polite"}), horizon = options(h("select", {onchange: () => table()}), HORIZONS, "1"), result = h("div", {});
  fill(place, h("h1", {id: "compare-title"}, "Compare"), h("p", {className: "lead"}, "Models side by side, on the stretches that are marked for validation."),
    h("div", {className: "panel"}, boxes, progress, h("div", {className: "bar"}, start, lack)), result);
  let drawn = null, shown = null, found = null;
  const chosen = new Set(), open = new Map();

  function begin() { studio.change("POST", "/api/fits", {compare: [...boxes.querySelectorAll("input:checked")].map(one => one.value)}); }

  function table() {
    if (!found) { fill(result); return; }
    const rows = found.rows.filter(row => row.horizon === Number(horizon.value)), stretches = [...new Set(rows.map(stretch))];
    const cells = (row, what) => {
      const told = one => one === null ? "–" : (shownAs(row.axis).factor * one).toPrecision(3), best = told(Math.min(...row[what].filter(one => one !== null)));
      return row[what].map((one, i) => h("td", {className: `number ${told(one) === best ? "strong" : ""}`}, told(one), row.fitted[i] ? h("abbr", {title: "fitted to part of this stretch: proves nothing"}, " *") : null));
    };
    const heads = what => found.columns.map(name => h("th", {className: "number", title: what}, name)), across = 2 * found.columns.length + 2;
    fill(result, h("article", {className: "panel"}, h("div", {className: "bar"}, h("h2", {}, title(shown)), labelled("Ahead", horizon, "field inline")),
      wide(h("table", {}, h("thead", {},
        h("tr", {}, h("th", {}), h("th", {colSpan: found.columns.length}, "Velocity RMSE [cm/s, yaw deg/s]"), h("th", {colSpan: found.columns.length}, "Position RMSE [cm, yaw deg]"), h("th", {})),
        h("tr", {}, h("th", {}, "Axis"), heads("velocity"), heads("position"), h("th", {className: "number"}, "n"))),
      stretches.map(one => h("tbody", {}, h("tr", {}, h("th", {colSpan: across}, h("span", {className: "stays"}, one))),
        rows.filter(row => stretch(row) === one).map(row => h("tr", {}, h("td", {}, row.axis), cells(row, "velocity"), cells(row, "position"), h("td", {className: "number"}, String(row.n)))))))),
      h("p", {className: "muted"}, "Bold: the smallest. hold keeps the velocity of the start; paper uses the paper's coefficients with a filter of their own, coast from the state of the model's filter; they are those of the first model that knows the axis, and each model is tested against its own. * fitted to part of this stretch."),
      paired(), [...(found.left_out ?? []).map(line => `left out: ${line}`), ...found.notes].map(note => h("p", {className: "muted"}, note))));
  }

  function paired() { // a fold for each pair: its verdicts stand on it, the figures in it, those of other horizons one fold deeper
    const folds = found.paired.map(test => ({test, name: `${test.first} against ${test.second}`, now: differences(test, horizon.value)})).filter(one => one.now.length);
    if (!folds.length) return null;
    return [h("h3", {}, "Is the difference real?"),
      h("p", {className: "muted"}, `Velocity RMSE of the first less that of the second, ± one standard error, ${horizon.value} s ahead; the verdict is at 95 %.`),
      folds.map(({test, name, now}, i) => {
        const others = HORIZONS.filter(([value]) => value !== horizon.value).flatMap(([value, words]) => differences(test, value).map(one => ({...one, words})));
        return h("details", {className: "pair", open: open.get(name) ?? i === 0, ontoggle: event => { if (event.target === event.currentTarget) open.set(name, event.target.open); }},
          h("summary", {}, h("strong", {}, name), ": ", now.map(one => `${one.axis} ${one.verdict}`).join(", ")),
          figures(["Axis", "Difference", "Verdict"], now.map(one => [one.axis, one.size, one.verdict])),
          others.length ? h("details", {}, h("summary", {}, "Other horizons"), figures(["Ahead", "Axis", "Difference", "Verdict"], others.map(one => [one.words, one.axis, one.size, one.verdict]))) : null);
      })];
  }

  function differences(test, ahead) {
    return Object.entries(test.axes).flatMap(([axis, horizons]) => {
      const one = horizons[ahead]?.velocity.pooled, {factor, unit} = shownAs(axis);
      if (!one) return [];
      const error = one.rmse_stderr === null ? "" : ` ± ${(factor * one.rmse_stderr).toPrecision(2)}`;
      return [{axis, size: `${(factor * one.rmse).toPrecision(3)}${error} ${unit}`, verdict: one.verdict.replaceAll("_", " ")}];
    });
  }

  const figures = (heads, rows) => wide(h("table", {}, h("thead", {}, h("tr", {}, heads.map(one => h("th", {}, one)))), h("tbody", {}, rows.map(row => h("tr", {}, row.map(one => h("td", {}, one)))))));

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
      return h("label", {className: "check", for: box.id}, box, title(one), h("span", {className: "muted"}, ` ${madeOf(one)}`), one.changed.length ? h("span", {className: "changed"}, ` ${changed(one)}`) : null);
    }), models.length ? null : h("p", {className: "muted"}, "None yet."));
    if (!last) { fill(result); return; }
    if (last.status === "done" && (!shown || shown.id !== last.id)) { shown = last; load(last); }
    if (last.status === "failed") { shown = null; fill(result, h("p", {className: "notice error"}, last.text)); }
  }
  return {draw};
}
