// Step 4: fit, with progress and cancel; then what came of it.

import {get} from "./api.js";
import {fill, h, labelled, options} from "./dom.js";
import {resultView} from "./result.js";

const MOST_MARKED = 4; // ranges that stand on a fit's card; the others are in its title

export function fitPanel(place, studio) {
  const {constants} = studio;
  const method = options(h("select", {}), Object.entries(constants.methods), "ml");
  const structure = options(h("select", {}), constants.structures.map(name => [name, name.replaceAll("_", " ")]), constants.structures[0]);
  const axes = constants.axes.map(axis => h("input", {type: "checkbox", id: `axis-${axis}`, value: axis, checked: true}));
  const uncertainty = h("input", {type: "checkbox", id: "uncertainty"});
  const start = h("button", {type: "submit", className: "primary"}, "Fit");
  const lack = h("p", {className: "muted"}), marked = h("div", {}), progress = h("div", {className: "progress", hidden: true}), list = h("ul", {className: "cards fits"}), stale = h("p", {className: "notice warning", hidden: true}), result = h("div", {id: "result"});
  const form = h("form", {className: "panel", onsubmit: event => {
    event.preventDefault();
    studio.change("POST", "/api/fits", {method: method.value, structure: structure.value, axes: axes.filter(one => one.checked).map(one => one.value), uncertainty: uncertainty.checked})
      .then(answer => { if (answer) { studio.chosen.write("fit", answer.id); studio.draw(); } });
  }},
    h("div", {className: "form"}, labelled("Method", method), labelled("Structure", structure),
      h("fieldset", {}, h("legend", {}, "Axes"), axes.map(one => h("label", {className: "check", for: one.id}, one, one.value))),
      h("label", {className: "check", for: "uncertainty"}, uncertainty, "accuracy table in the report (slower)")),
    marked, h("div", {className: "bar"}, start, lack), progress);
  fill(place, h("h1", {id: "fit-title"}, "Fit"), form, list, stale, result);
  let shown = null, drawn = null;

  function ranges(session) {
    const words = {train: [], validate: []};
    for (const log of session.uploads) for (const one of log.ranges) {
      const whole = one.start === null && one.end === null;
      words[one.role].push(whole ? log.name : `${log.name} ${one.start ?? "start"} to ${one.end ?? "end"} s`);
    }
    const line = (role, title) => h("p", {}, h("span", {className: `swatch ${role}`, "aria-hidden": true}), h("strong", {}, title), " ", words[role].join(" · ") || h("span", {className: "muted"}, "nothing is marked"));
    fill(marked, line("train", "Training:"), line("validate", "Validation:"));
    return words;
  }

  function drawProgress({running}, fits) {
    progress.hidden = !running;
    if (!running) return;
    const fit = fits.find(one => one.id === running.id), bar = progress.querySelector("progress");
    const words = `${title(fit)}: ${running.text}`;
    if (bar && progress.dataset.fit === running.id) {
      bar.value = running.fraction;
      progress.querySelector("p").textContent = words;
      return;
    }
    progress.dataset.fit = running.id;
    fill(progress, h("p", {"aria-live": "polite"}, words), h("div", {className: "bar"}, h("progress", {max: 1, value: running.fraction, "aria-label": "Progress of the fit"}),
      h("button", {type: "button", onclick: () => studio.change("POST", `/api/fits/${running.id}/cancel`)}, "Cancel")));
  }

  function drawList(fits) {
    fill(list, [...fits].reverse().map(fit => h("li", {className: `${fit.status} ${fit.id === shown ? "chosen" : ""}`, "data-fit": fit.id},
      h("button", {type: "button", className: "title", "aria-pressed": String(fit.id === shown), onclick: () => { studio.chosen.write("fit", fit.id); studio.draw(); }}, title(fit)),
      h("span", {className: "muted"}, madeOf(fit)),
      h("span", {className: "muted", title: fit.logs.join("\n")}, `${fit.logs.slice(0, MOST_MARKED).join("; ")}${fit.logs.length > MOST_MARKED ? "; …" : ""}`),
      fit.changed.length ? h("span", {className: "changed"}, changed(fit)) : null,
      h("span", {className: `outcome ${fit.status}`}, fit.status === "running" ? "running" : fit.text),
      fit.status === "running" ? null : h("button", {type: "button", className: "close", "aria-label": `Remove ${title(fit)}`, onclick: () => studio.change("DELETE", `/api/fits/${fit.id}`)}, "×"))));
  }

  async function drawResult(fit) {
    fill(result, h("p", {className: "muted"}, "Reading the result …"));
    try {
      const found = await get(`/api/fits/${fit.id}/result.json`);
      if (shown === fit.id) fill(result, resultView(fit, found, constants));
    } catch (error) { fill(result, h("p", {className: "notice error"}, error.message)); }
  }

  function draw({session}) {
    const words = ranges(session), why = !session.uploads.length ? "Add a log first." : !session.card ? "There is no card yet." : session.problem ? "The card has an error." : !words.train.length ? "Mark a stretch for training." : "";
    start.disabled = Boolean(why || session.running);
    lack.textContent = session.running ? "" : why || (words.validate.length ? "" : "Without a stretch for validation nothing is proved.");
    drawProgress(session, session.fits);
    const fits = session.fits.filter(one => one.settings.kind === "fit"), wanted = studio.chosen.read("fit");
    const fit = fits.find(one => one.id === wanted) || fits.filter(one => one.status === "done").pop() || fits[fits.length - 1] || null, key = fit ? `${fit.id}/${fit.status}` : "";
    if (drawn !== `${session.revision}/${key}`) {
      drawn = `${session.revision}/${key}`;
      const before = `${shown}/${result.dataset.status}`;
      shown = fit ? fit.id : null;
      drawList(fits);
      stale.hidden = !fit?.changed.length;
      stale.textContent = fit ? `${title(fit)}: ${changed(fit)}. Fit again to use what is set now.` : "";
      if (`${shown}/${fit ? fit.status : ""}` !== before) {
        result.dataset.status = fit ? fit.status : "";
        if (fit && fit.status === "done") drawResult(fit);
        else fill(result, fit && fit.status !== "running" ? h("p", {className: "notice error"}, `${title(fit)}: ${fit.text}.`) : null);
      }
    }
  }
  return {draw};
}

export function madeOf(fit) { // fits of an earlier studio do not know the revision of their card
  const {method, structure, axes, card_revision: card} = fit.settings;
  return [method, structure.replaceAll("_", " "), axes.join(" "), ...(card === undefined ? [] : [`card ${card}`])].join(" · ");
}

export function changed(fit) { return `${fit.changed.join(" and ")} changed since`; }

export function title(fit) { return fit.settings.kind === "compare" ? `Comparison ${fit.id}` : `Fit ${fit.id}`; }
