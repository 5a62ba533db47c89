"use strict";
// One box that says what a word, a number or a point of a chart means: on hover, on focus, on touch, by arrow keys.
const figures = (() => {
  const tip = document.getElementById("tip");
  let hiding = 0, shown = 0;

  const place = (x, top, bottom) => { // below, or above where there is no room
    tip.hidden = false;
    shown = scrollY;
    const width = tip.offsetWidth, height = tip.offsetHeight;
    tip.style.left = Math.max(6, Math.min(x - width / 2, innerWidth - width - 6)) + "px";
    tip.style.top = (bottom + 8 + height < innerHeight ? bottom + 8 : Math.max(6, top - height - 8)) + "px";
  };
  const hide = () => { tip.hidden = true; };
  const say = (name, text, x, top, bottom) => {
    clearTimeout(hiding);
    const strong = document.createElement("b");
    strong.textContent = name ? name + " " : "";
    tip.replaceChildren(strong, text);
    place(x, top, bottom);
  };

  addEventListener("scroll", () => { if (Math.abs(scrollY - shown) > 60) hide(); }, {passive: true});

  const meaning = id => document.getElementById(id)?.lastChild.textContent.trim() || "";
  const column = cell => cell.closest("table")?.tHead?.rows[0].cells[
    cell.cellIndex + cell.closest("table").tHead.rows[0].cells.length - cell.parentNode.cells.length];
  const explain = element => {
    const box = element.getBoundingClientRect(), told = element.dataset.tip;
    let name = element.textContent.trim(), text = told || "";
    if (element.classList.contains("term")) text = meaning(element.getAttribute("popovertarget"));
    else if (told) name = "";
    else {
      const head = column(element);
      text = (head ? head.textContent.trim() + ": " : "") + meaning("def-" + element.dataset.def);
    }
    say(name, text, box.left + box.width / 2, box.top, box.bottom);
  };

  const SPOKEN = ".term, [data-tip], [data-def]";
  document.addEventListener("pointerover", event => {
    const element = event.target.closest?.(SPOKEN);
    if (element) explain(element);
    else if (event.target.closest?.("#tip")) clearTimeout(hiding);
  });
  document.addEventListener("pointerout", event => {
    if (event.target.closest?.(SPOKEN + ", #tip, .chart")) { clearTimeout(hiding); hiding = setTimeout(hide, 200); }
  });
  document.addEventListener("focusin", event => {
    const element = event.target.closest?.(SPOKEN);
    if (element) explain(element);
  });
  document.addEventListener("focusout", hide);
  document.addEventListener("click", event => {
    const element = event.target.closest?.(SPOKEN);
    if (!element) return;
    if (element.classList.contains("term")) event.preventDefault(); // the box stands in for the popover
    explain(element);
  });
  document.addEventListener("keydown", event => { if (event.key === "Escape") hide(); });

  // Tables: one stop of the Tab key each, from there the arrow keys go from cell to cell.
  const STEPS = {ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0]};
  document.querySelectorAll(".scroll").forEach(region => region.addEventListener("keydown", event => {
    const step = STEPS[event.key], rows = [...region.querySelectorAll("tbody tr")];
    if (!step || !rows.length || event.target.closest("button")) return;
    event.preventDefault();
    const now = event.target.closest("td, th"), row = now ? rows.indexOf(now.parentNode) : -1;
    const next = now ? rows[Math.max(0, Math.min(rows.length - 1, row + step[0]))] : rows[0];
    const last = next.cells.length - 1, at = now ? now.cellIndex - now.parentNode.cells.length : 0;
    const cell = next.cells[Math.max(0, Math.min(last, now ? at + next.cells.length + step[1] : 0))];
    cell.tabIndex = -1;
    cell.focus();
  }));

  // Charts: pointer and arrow keys find the nearest figures, which stand in the list below the picture.
  document.querySelectorAll(".chart[data-along]").forEach(chart => {
    const list = chart.nextElementSibling;
    const stops = [...list.querySelectorAll("li")].map(li => ({at: +li.dataset.at, text: li.textContent}));
    if (!stops.length) return;
    const {along, left, top, width, height} = chart.dataset;
    const hair = document.createElementNS(chart.namespaceURI, "path");
    hair.setAttribute("class", "hair");
    chart.append(hair);
    let now = -1;
    const go = number => {
      now = Math.max(0, Math.min(stops.length - 1, number));
      const stop = stops[now], box = chart.getBoundingClientRect(), scale = box.width / chart.viewBox.baseVal.width;
      const at = +(along === "x" ? left : top) + stop.at;
      hair.setAttribute("d", along === "x" ? `M${at} ${top}v${height}` : `M${left} ${at}h${width}`);
      if (along === "x") say("", stop.text, box.left + at * scale, box.top, box.bottom);
      else say("", stop.text, box.left + box.width / 2, box.top + (at - 12) * scale, box.top + (at + 12) * scale);
    };
    chart.addEventListener("pointermove", event => {
      const box = chart.getBoundingClientRect(), scale = box.width / chart.viewBox.baseVal.width;
      const at = along === "x" ? (event.clientX - box.left) / scale - left : (event.clientY - box.top) / scale - top;
      go(stops.reduce((best, stop, k) => Math.abs(stop.at - at) < Math.abs(stops[best].at - at) ? k : best, 0));
    });
    chart.addEventListener("keydown", event => {
      const step = {ArrowLeft: -1, ArrowUp: -1, ArrowRight: 1, ArrowDown: 1}[event.key];
      if (event.key === "Home") go(0);
      else if (event.key === "End") go(stops.length - 1);
      else if (step) go(now + step);
      else return;
      event.preventDefault();
    });
    for (const leaving of ["pointerleave", "blur"]) chart.addEventListener(leaving, () => hair.removeAttribute("d"));
  });

  return {say, hide};
})();
