// Elements from plain values. Text only ever becomes text: nothing here makes markup of a string.

export function h(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && typeof value !== "string") element[name] = value;
    else element.setAttribute(name === "className" ? "class" : name, value === true ? "" : String(value));
  }
  element.append(...children.flat(Infinity).filter(child => child !== null && child !== undefined && child !== false));
  return element;
}

export function fill(element, ...children) {
  element.replaceChildren(...children.flat(Infinity).filter(child => child !== null && child !== undefined && child !== false));
  return element;
}

export function options(select, pairs, chosen) {
  fill(select, pairs.map(([value, words]) => h("option", {value, selected: value === chosen}, words)));
  return select;
}

let labels = 0;
export function labelled(words, control, className = "field") {
  control.id = control.id || `control-${++labels}`;
  return h("div", {className}, h("label", {for: control.id}, words), control);
}

export function notice(kind, text, action = null) {
  const place = document.getElementById("notices");
  if (!action) for (const old of [...place.children]) if (old.dataset.text === text) old.remove(); // each offer is of another text
  const element = h("div", {className: `notice ${kind}${action ? " offer" : ""}`, "data-text": text}, h("p", {}, text));
  if (action) element.append(h("button", {type: "button", onclick: () => { element.remove(); action.run(); }}, action.words));
  element.append(h("button", {type: "button", className: "close", "aria-label": "Dismiss", onclick: () => element.remove()}, "×"));
  place.append(element);
  if (kind === "info") setTimeout(() => element.remove(), 6000);
  return element;
}

export function cleared() { // what was said on another page; not what offers to put text back, nor that the studio is silent
  for (const old of document.querySelectorAll("#notices > .notice:not(.lost, .offer)")) old.remove();
}

export function wide(table) { // a table that goes on beside the screen says so
  const hint = h("p", {className: "hint", hidden: true}, "Scroll the table sideways for the rest →"), place = h("div", {className: "scroll"}, table);
  new ResizeObserver(() => { hint.hidden = place.scrollWidth <= place.clientWidth + 1; }).observe(place);
  return h("div", {}, hint, place);
}

export function later(milliseconds, run) { // the last call wins
  let timer = 0;
  return (...values) => { clearTimeout(timer); timer = setTimeout(run, milliseconds, ...values); };
}

export function bytes(count) {
  const units = ["B", "kB", "MB", "GB"];
  let power = 0;
  while (count >= 1000 && power < 3) { count /= 1000; power += 1; }
  return `${count.toFixed(count < 10 && power ? 1 : 0)} ${units[power]}`;
}

export function whole(count) { return Math.round(count).toLocaleString("en").replaceAll(",", "\u202f"); }

export function motionUnits(axis, commands) { return ` velocity [${axis === "yaw" ? "rad/s" : "m/s"}], left; command [${commands[axis]}], right`; }

export function seconds(value) { return value === null || value === undefined ? "" : `${Number(value.toFixed(2))}`; }

export function findingList(findings, empty) {
  if (!findings.length) return h("p", {className: "muted"}, empty);
  return h("ul", {className: "findings"}, findings.map(one => h("li", {className: `finding ${one.severity}`},
    h("p", {className: "what"}, h("span", {className: "badge"}, one.severity), " ",
      h("strong", {}, one.code.replaceAll("_", " ")), one.axis ? h("span", {className: "muted"}, ` · ${one.axis}`) : null),
    h("p", {}, `${one.evidence}.`),
    h("p", {className: "muted"}, `Effect: ${one.effect}.`),
    h("p", {className: "muted"}, `Try: ${one.remedy}.`))));
}
