// Step 1: drop logs, see what is in them.

import {get, upload} from "./api.js";
import {bytes, fill, h, labelled, notice, whole} from "./dom.js";
import {Together, WindowPlot} from "./plot.js";

const MOST_PLOTS = 6;

export function logsPanel(place, studio) {
  const picker = h("input", {type: "file", multiple: true, id: "file-picker", className: "hidden", onchange: () => { receive(picker.files); picker.value = ""; }});
  const zone = h("div", {className: "zone"},
    h("p", {className: "lead"}, "Drop one or several logs here"),
    h("p", {className: "muted"}, `${studio.constants.formats.join(", ")}. They stay on this machine.`),
    picker, h("label", {for: "file-picker", className: "button primary"}, "Choose files"));
  const queue = h("ul", {className: "queue", "aria-live": "polite"});
  const list = h("ul", {className: "cards"});
  const detail = h("div", {id: "log-detail"});
  fill(place, h("h1", {id: "logs-title"}, "Logs"), zone, queue, list, detail);
  let shown = null, drawn = null;

  function receive(files) {
    (async () => { for (const file of [...files]) await one(file); })();
  }

  async function one(file) {
    const bar = h("progress", {max: 1, value: 0, "aria-label": `Upload of ${file.name}`}), words = h("span", {className: "muted"}, "waiting");
    const item = h("li", {}, h("strong", {}, file.name), " ", bar, " ", words);
    queue.append(item);
    if (file.size > studio.constants.largest_log) {
      return refuse(item, file.name, `${file.name}: ${bytes(file.size)}, more than the ${bytes(studio.constants.largest_log)} that a log may have`);
    }
    try {
      const {id} = await upload(file, share => {
        if (share === null || share === 1) bar.removeAttribute("value"); else bar.value = share;
        words.textContent = share === 1 ? "reading" : "uploading";
      });
      item.remove();
      studio.chosen.write("log", id);
      await studio.caughtUp();
    } catch (error) { refuse(item, file.name, error.message); }
    return undefined;
  }

  function refuse(item, name, line) {
    item.className = "refused";
    fill(item, h("p", {}, h("strong", {}, `${name} was not added: `), line.startsWith(`${name}: `) ? line.slice(name.length + 2) : line),
      h("button", {type: "button", className: "close", "aria-label": "Dismiss", onclick: () => item.remove()}, "×"));
  }

  const veil = document.getElementById("drop");
  addEventListener("dragover", event => { if ([...event.dataTransfer.types].includes("Files")) { event.preventDefault(); veil.hidden = false; } });
  addEventListener("dragleave", event => { if (!event.relatedTarget) veil.hidden = true; });
  addEventListener("drop", event => {
    event.preventDefault();
    veil.hidden = true;
    if (event.dataTransfer.files.length) { studio.go("logs"); receive(event.dataTransfer.files); }
  });

  function drawList(session) {
    fill(list, session.uploads.map(one => h("li", {className: one.id === shown ? "chosen" : ""},
      h("button", {type: "button", className: "title", "aria-pressed": String(one.id === shown), onclick: () => studio.look(one.id)}, one.name),
      h("span", {className: "muted"}, `${one.format} · ${bytes(one.size)} · ${use(one)}`),
      h("button", {type: "button", className: "close", "aria-label": `Remove ${one.name}`, onclick: () => studio.change("DELETE", `/api/logs/${one.id}`)}, "×"))));
  }

  async function drawDetail(log) {
    fill(detail, h("p", {className: "muted"}, `Reading ${log.name} …`));
    let found;
    try { found = await get(`/api/logs/${log.id}`); } catch (error) { fill(detail, h("p", {className: "notice error"}, error.message)); return; }
    if (shown !== log.id) return;
    fill(detail, h("article", {className: "panel"}, h("h2", {}, log.name), streams(log, found)), h("article", {className: "panel"}, h("h2", {}, "Tables"), tables(found),
      found.notes.length ? h("details", {}, h("summary", {}, `${found.notes.length} notes on reading`), h("ul", {}, found.notes.map(note => h("li", {}, note)))) : null,
      h("p", {className: "muted hash"}, `SHA-256 ${found.sha256}`)),
      h("p", {}, h("a", {className: "button primary", href: "#card"}, "Next: the card")));
  }

  function tables(found) {
    return h("div", {className: "scroll"}, h("table", {},
      h("thead", {}, h("tr", {}, ["Table", "Samples", "Rate", "Gaps", "Columns"].map((head, i) => h("th", {className: i && i < 4 ? "number" : ""}, head)))),
      h("tbody", {}, found.tables.map(table => h("tr", {},
        h("th", {}, table.name), h("td", {className: "number"}, whole(table.count)),
        h("td", {className: "number"}, table.rate && table.rate.period ? `${(1 / table.rate.period).toPrecision(3)} Hz` : "no clock"),
        h("td", {className: "number"}, table.rate ? whole(table.rate.gaps) : "–"),
        h("td", {className: "muted columns"}, table.columns.map(column => column.name).join(", ")))),
      Object.entries(found.skipped).map(([name, why]) => h("tr", {className: "muted"}, h("th", {}, name), h("td", {colSpan: 4}, `not decoded: ${why}`))))));
  }

  function streams(log, found) {
    const together = new Together(), plots = h("div", {className: "stack"});
    const clocks = new Map(found.tables.flatMap(table => table.columns.map(column => [column.source, table.clock]))), columns = [...clocks.keys()];
    const add = source => {
      if (!columns.includes(source)) { notice("warning", `There is no column ${source}; choose one of the list.`); return; }
      if (plots.children.length >= MOST_PLOTS) plots.lastChild.remove();
      const canvas = h("div", {}), state = h("span", {className: "muted"});
      plots.append(h("figure", {}, h("figcaption", {}, h("strong", {}, source), " ", state), canvas));
      new WindowPlot(canvas, {
        path: `/api/logs/${log.id}/column?source=${encodeURIComponent(source)}`, lines: [{name: "value", role: "model"}], together, height: 150, label: source, along: clocks.get(source) === null ? "row" : "t [s]",
        onloaded: data => { state.textContent = told(data); studio.draft(); }, onerror: error => { state.textContent = error.message; },
      });
    };
    const names = h("datalist", {id: "column-names"}, columns.map(value => h("option", {value})));
    const input = h("input", {list: "column-names", placeholder: "type to search", autocomplete: "off", onchange: () => { if (input.value) { add(input.value); input.value = ""; } }});
    requestAnimationFrame(() => first(columns).forEach(add));
    return h("div", {}, h("div", {className: "bar"}, labelled("Show a column", input, "field inline"), names,
      h("button", {type: "button", onclick: () => plots.lastChild && plots.lastChild.remove()}, "Remove the last"), together.tools()), plots);
  }

  function draw({session}) {
    const log = studio.log(), id = log ? log.id : null;
    zone.classList.toggle("slim", session.uploads.length > 0);
    if (id !== shown) { shown = id; drawn = null; if (log) drawDetail(log); else fill(detail); }
    if (drawn !== session.revision) { drawn = session.revision; drawList(session); }
  }
  return {draw};
}

export function told(data) {
  return data.exact ? `${whole(data.samples)} samples, each drawn` : `${whole(data.samples)} samples, drawn by their extremes`;
}

function use(log) {
  const roles = new Set(log.ranges.map(one => one.role));
  return [roles.has("train") ? "training" : "", roles.has("validate") ? "validation" : ""].filter(Boolean).join(" and ") || "not used";
}

function first(columns) { // what most people want to see first: a position, a command
  const wanted = [/(^|[.:_])(position\.)?x$/i, /(cmd|command|vel|twist).*x$/i];
  const found = wanted.map(pattern => columns.find(name => pattern.test(name))).filter(Boolean);
  return [...new Set(found.length ? found : columns.slice(0, 2))];
}
