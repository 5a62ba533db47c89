// Step 2: which column is what, with its sign and unit; and at once what the flight looks like then.

import {get} from "./api.js";
import {fill, findingList, h, labelled, later, motionUnits, notice, options, seconds} from "./dom.js";
import {legendOf, Together, WindowPlot} from "./plot.js";

const LINES = [{name: "command", role: "command", scale: "command", stepped: true}, {name: "velocity", role: "measured"}];

const MEANINGS = [["", "not said"], ["tilt", "tilt"], ["velocity", "velocity"], ["vertical_speed", "vertical speed"], ["yaw_rate", "yaw rate"]];
const FULL = [["", "in its unit"], ["tilt", "of the tilt limit"], ["vertical_speed", "of the vertical speed limit"], ["yaw_rate", "of the yaw rate limit"], ["speed", "of the speed limit"]];
const LEADS = {x: ["leads forward", "leads backward"], y: ["leads left", "leads right"], z: ["leads up", "leads down"], yaw: ["turns left", "turns right"]};
const LIMIT_WORDS = {tilt: "tilt", vertical_speed: "vertical speed", yaw_rate: "yaw rate", speed: "speed"};

export function cardPanel(place, studio) {
  const log = h("select", {onchange: () => studio.look(log.value)}), start = h("select", {className: "start", onchange: () => begin()});
  const table = h("div", {className: "card-table"}), limits = h("div", {className: "limits"}), problem = h("p", {className: "notice error", hidden: true});
  const text = h("textarea", {spellcheck: false, rows: 22, "aria-label": "The card as TOML", oninput: () => typed()});
  const names = h("datalist", {id: "card-columns"});
  const flight = h("div", {className: "flight"}), findings = h("div", {className: "found"}), about = h("p", {className: "muted"}), revision = h("span", {className: "muted"});
  const top = h("div", {className: "bar"}, labelled("Seen on", log, "field inline"), labelled("Start anew from", start, "field inline"),
    h("a", {className: "button", href: "/api/card.toml", download: "card.toml"}, "Download card"));
  fill(place, h("h1", {id: "card-title"}, "Card"),
    h("p", {className: "lead"}, "Which column is what. After its sign, + must mean forward, left, up, and counter-clockwise seen from above."),
    top, problem,
    h("div", {className: "split"},
      h("div", {}, h("div", {className: "panel"}, table, h("h2", {}, "Limits of the vehicle"), limits, names),
        h("details", {className: "panel", open: true}, h("summary", {}, h("h2", {}, "As text (TOML)"), revision), text)),
      h("div", {className: "sticky"}, h("div", {className: "panel"}, h("h2", {}, "What it makes of the log"), about, flight), h("div", {className: "panel"}, h("h2", {}, "Findings"), findings))),
    h("p", {className: "next"}, h("a", {className: "button primary", href: "#ranges"}, "Next: ranges")));
  let drawnCard = -1, drawnText = null, drawnLogs = "", seenOn = "", columnsOf = null;

  const change = (body, refused) => studio.change("PUT", "/api/card", {seen: studio.session.card_revision, ...body}, refused);
  const edit = edits => change({edits}, status => { if (status === 409) notice("warning", "Your value was not kept.", {words: "Put my value in its place", run: () => edit(edits)}); });

  // The text. What was typed stands here until the server has it, or in a notice that offers it: no order of refusals and
  // of answers that fail or come late loses it.
  let typedOn = null; // the revision that the text was typed on; null where it is the server's
  let saving = false;
  const saved = later(500, () => save());
  const typed = () => { typedOn ??= studio.session.card_revision; drawnText = null; saved(); };
  addEventListener("beforeunload", event => { if (typedOn !== null) event.preventDefault(); });

  async function save() {
    if (typedOn === null) return;
    if (saving) { saved(); return; } // its answer says which revision this one stands on
    saving = true;
    const mine = text.value;
    try {
      const answer = await change({text: mine, seen: typedOn}, () => offer());
      if (answer !== null) typedOn = text.value === mine ? null : answer.card_revision;
      draw(studio);
    } catch (error) {
      if (!(error instanceof TypeError)) throw error;
      saved(); // it did not get through: the page says so, and tries again
    } finally { saving = false; }
  }

  function offer() { // shows the server's text, and what was typed until now can come back
    const mine = text.value;
    typedOn = null;
    draw(studio);
    if (mine !== text.value) notice("warning", "Your text of the card was not kept.", {words: "Put my text in its place", run: () => put(mine)});
  }

  function put(mine) {
    if (typedOn !== null) offer();
    text.value = mine;
    typed();
  }

  function begin() {
    const [kind, name] = start.value.split("|");
    start.value = "";
    if (kind === "draft") change({draft: name});
    if (kind === "builtin") change({builtin: name});
  }

  // The table

  function rows(session) {
    const raw = session.raw;
    if (!raw) { fill(table, h("p", {className: "empty"}, "The text cannot be read as TOML: correct it below.")); fill(limits); return; }
    const of = (section, key) => (raw[section] || {})[key];
    const frames = h("div", {className: "bar"},
      labelled("Frame of the pose", choice(["ENU", "NED"], raw.frame || "ENU", value => edit([{section: "", key: "frame", value}])), "field inline"),
      labelled("Commands act in the", choice(["heading", "world"], of("command", "frame") || "heading", value => edit([{section: "command", key: "frame", value}])), "field inline"),
      labelled("Hold [s]", figure(of("command", "hold"), "auto", value => edit([{section: "command", key: "hold", value}])), "field inline"));
    const groups = ["command", "pose", "velocity"].map(section => {
      const lines = studio.constants.quantities.filter(one => one.section === section).map(one => row(one, of(section, one.key), of("pose", "yaw") !== undefined));
      const words = {command: "Commands", pose: "Pose", velocity: "Onboard velocity, where there is one"}[section];
      return section === "velocity" ? h("details", {open: Boolean(raw.velocity)}, h("summary", {}, h("h2", {}, words)), lines) : [h("h2", {}, words), lines];
    });
    fill(table, frames, groups);
    fill(limits, Object.entries(studio.constants.limits).map(([key, units]) => limit(key, units, of("limits", key))));
  }

  function row({section, key, words, units}, value) {
    const listed = Array.isArray(value) && key !== "quaternion";
    const parts = value !== null && typeof value === "object" && !Array.isArray(value) ? value : {from: value};
    const set = more => {
      const next = {...parts, ...more};
      for (const name of Object.keys(next)) if (next[name] === "" || next[name] === null || next[name] === undefined || (name === "scale" && next[name] === 1) || (name === "offset" && next[name] === 0)) delete next[name];
      const bare = Object.keys(next).length === 1 && next.from !== undefined ? next.from : next;
      edit([{section, key, value: next.from === undefined ? null : bare}]);
    };
    const shown = listed ? `${value.length} names, see the text` : parts.from === undefined ? "" : Array.isArray(parts.from) ? parts.from.join(", ") : String(parts.from);
    const column = h("input", {className: "column", list: key === "quaternion" ? null : "card-columns", autocomplete: "off", spellcheck: false, placeholder: section === "velocity" || key === "quaternion" ? "none" : "type to search", disabled: listed,
      onchange: () => set({from: source(column.value, key)})});
    column.value = column.title = shown;
    requestAnimationFrame(() => { column.scrollLeft = column.scrollWidth; }); // the end of a long name says what it is
    const label = h("div", {className: "quantity"}, labelled(words, column));
    if (listed || parts.from === undefined || key === "quaternion") return h("div", {className: "row"}, label);
    const scale = typeof parts.scale === "number" ? parts.scale : 1;
    const sign = h("button", {type: "button", className: `sign ${scale < 0 ? "turned" : ""}`, "aria-pressed": String(scale < 0), "aria-label": `Turn the sign of ${words}`, title: "Turn the sign", onclick: () => set({scale: -scale})}, scale < 0 ? "− turned" : "+ as logged");
    const factor = figure(scale === 1 ? undefined : scale, "1", value => set({scale: value ?? 1}));
    factor.setAttribute("aria-label", `Factor of ${words}`);
    const unit = choice(["", ...units], parts.unit || "", value => set({unit: value}), value => value || (key === "time" ? "auto" : section === "command" ? "no unit" : units[0]));
    unit.setAttribute("aria-label", `Unit of ${words}`);
    const further = section === "command" && key !== "time" ? h("div", {className: "further"},
      meaning("Means", MEANINGS, parts.meaning, value => set({meaning: value})), meaning("As a share", FULL, parts.full_scale, value => set({full_scale: value}))) : null;
    return h("div", {className: "row"}, label, key === "time" ? h("span", {}) : sign, key === "time" ? h("span", {}) : factor, unit, further);
  }

  function meaning(words, pairs, value, set) {
    const select = h("select", {onchange: () => set(select.value)});
    options(select, pairs, value || "");
    return labelled(words, select, "field inline small");
  }

  function choice(values, value, set, words = one => one) {
    const select = h("select", {onchange: () => set(select.value)});
    return options(select, values.map(one => [one, words(one)]), value);
  }

  function figure(value, blank, set) {
    const input = h("input", {type: "number", step: "any", className: "figure", placeholder: blank, onchange: () => set(input.value === "" ? null : Number(input.value))});
    input.value = value === undefined ? "" : String(value);
    return input;
  }

  function limit(key, units, value) {
    const parts = value !== null && typeof value === "object" ? value : value === undefined ? {} : {value};
    const set = more => { const next = {unit: units[1] || units[0], ...parts, ...more}; edit([{section: "limits", key, value: next.value === null || next.value === undefined ? null : next}]); };
    const input = figure(parts.value, "not known", number => set({value: number}));
    const unit = choice(units, parts.unit || units[0], one => set({unit: one}));
    unit.setAttribute("aria-label", `Unit of the limit of ${LIMIT_WORDS[key]}`);
    return h("div", {className: "limit"}, labelled(LIMIT_WORDS[key], input), parts.value === undefined ? null : unit);
  }

  // The flight

  async function look(one, session) {
    const key = `${one ? one.id : ""}/${session.card_revision}`;
    if (key === seenOn) return;
    seenOn = key;
    if (!one || !session.card) { fill(flight); fill(findings); about.textContent = one ? "A card is being drafted …" : "There is no log yet."; return; }
    if (columnsOf !== one.id) {
      columnsOf = one.id;
      get(`/api/logs/${one.id}`).then(found => fill(names, found.tables.flatMap(part => part.columns.map(column => h("option", {value: column.source}))))).catch(() => { columnsOf = null; });
    }
    about.textContent = "Reading the flight …";
    about.className = "muted";
    try {
      const found = await get(`/api/logs/${one.id}/flight`);
      if (seenOn !== key) return;
      about.textContent = `${seconds(found.duration)} s of flight, ${found.poses} poses, ${found.commands} commands. Where a command rises, its velocity must rise soon after.`;
      motion(one, found);
      fill(findings, h("p", {className: "muted"}, "Looking for trouble …"));
      const told = await get(`/api/logs/${one.id}/findings`);
      if (seenOn !== key) return;
      fill(findings, findingList(told.findings, "Nothing wrong was found."));
      for (const place of flight.querySelectorAll("[data-axis]")) fill(place, answer(place.dataset.axis, told.answers[place.dataset.axis]));
    } catch (error) {
      if (seenOn !== key) return;
      about.textContent = error.message;
      about.className = "notice error";
      fill(flight);
      fill(findings, h("p", {className: "muted"}, "They come with a card that fits the log."));
    }
  }

  function motion(one, found) {
    const together = new Together();
    const figures = found.axes.map(axis => {
      const canvas = h("div", {});
      requestAnimationFrame(() => new WindowPlot(canvas, {
        path: `/api/logs/${one.id}/motion?axis=${axis}`, together, height: 150, label: `Command and velocity ${axis}`,
        lines: LINES, legend: false,
      }));
      return h("figure", {}, h("figcaption", {}, h("span", {}, h("strong", {}, axis), h("span", {className: "muted"}, motionUnits(axis, found.commands_in))), " ", h("span", {className: "told", "data-axis": axis})), canvas);
    });
    fill(flight, h("div", {className: "bar"}, together.tools(), legendOf(LINES)), h("div", {className: "motions"}, figures),
      found.notes.length ? h("details", {}, h("summary", {}, `${found.notes.length} repairs`), h("ul", {}, found.notes.map(note => h("li", {}, note)))) : null);
  }

  function answer(axis, told) { // what the motion says of a command
    if (!told) return h("span", {className: "muted"}, "the motion does not tell");
    const sure = `${told.certainty.toFixed(0)} standard errors`;
    if (!told.axis) return h("span", {className: "muted", title: sure}, "the motion does not tell the sign");
    if (told.axis !== axis) return h("span", {className: "wrong", title: sure}, `the motion follows it along ${told.axis}`);
    if (told.sign > 0) return h("span", {className: "right", title: sure}, `✓ + ${LEADS[axis][0]}`);
    return h("button", {type: "button", className: "small wrong", title: sure, onclick: () => table.querySelector(`[aria-label="Turn the sign of command ${axis}"]`)?.click()}, `+ ${LEADS[axis][1]}: turn the sign`);
  }

  let halfTyped = false; // a value of the table, which a table drawn anew would forget
  for (const [kind, half] of [["input", true], ["change", false], ["focusout", false]]) {
    for (const part of [table, limits]) part.addEventListener(kind, () => { halfTyped = half; }, true);
  }

  function draw({session, constants}) {
    const one = studio.log(), logs = JSON.stringify([session.uploads.map(each => [each.id, each.name]), one && one.id]);
    if (logs !== drawnLogs) {
      drawnLogs = logs;
      options(log, session.uploads.map(each => [each.id, each.name]), one && one.id);
      options(start, [["", "choose"], ...session.uploads.map(each => [`draft|${each.id}`, `a draft for ${each.name}`]), ...Object.entries(constants.cards).map(([name, words]) => [`builtin|${name}`, `${name}: ${words}`])], "");
    }
    if (typedOn === null && drawnText !== session.card) {
      drawnText = session.card;
      revision.textContent = ` card ${session.card_revision}`;
      if (text.value !== session.card) text.value = session.card;
    }
    if (drawnCard !== session.card_revision && !halfTyped) {
      const focused = document.activeElement, again = focused && table.contains(focused) ? focused.id || focused.getAttribute("aria-label") : null;
      drawnCard = session.card_revision;
      problem.textContent = session.problem || "";
      problem.hidden = !session.problem;
      rows(session);
      if (again) [...table.querySelectorAll("[aria-label]")].find(each => each.getAttribute("aria-label") === again)?.focus();
    }
    look(one, session);
  }
  return {draw};
}

function source(value, key) { // a constant is a number; a quaternion may be four names
  const plain = value.trim();
  if (!plain) return null;
  if (key === "quaternion" && plain.includes(",")) return plain.split(",").map(part => part.trim());
  return /^[-+]?\d+(\.\d*)?(e[-+]?\d+)?$/i.test(plain) ? Number(plain) : plain;
}
