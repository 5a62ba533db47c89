// The page: one session of the server, shown in five steps. What the server says is the truth; this only draws it.

import {get, Refusal, send} from "./api.js";
import {cardPanel} from "./card.js";
import {comparePanel} from "./compare.js";
import {cleared, fill, h, notice} from "./dom.js";
import {fitPanel} from "./fit.js";
import {livePanel} from "./live.js";
import {logsPanel} from "./logs.js";
import {rangesPanel} from "./ranges.js";

if (location.search) history.replaceState(null, "", location.pathname + location.hash); // the token stays in the cookie

const STEPS = [["logs", "Logs"], ["card", "Card"], ["ranges", "Ranges"], ["fit", "Fit"], ["compare", "Compare"]];
const PAGES = [...STEPS, ["live", "Live"]]; // Live is no step on the way from a log to a model

const studio = {
  constants: null,
  session: null,
  chosen: { // kept by the tab, also over a reload
    read: name => sessionStorage.getItem(`rotorfit-${name}`),
    write: (name, value) => sessionStorage.setItem(`rotorfit-${name}`, value),
  },
  log() { // the log that this tab looks at
    const {uploads} = this.session;
    return uploads.find(one => one.id === this.chosen.read("log")) || uploads[0] || null;
  },
  look(id) { this.chosen.write("log", id); this.draw(); },
  async change(method, path, body = {}, refused = () => {}) { // asks for a change, and shows what came of it; null where it was refused
    let answer = null, status = 0;
    try { answer = await send(method, path, body); } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      status = error.status;
      notice(status === 409 ? "warning" : "error", error.message);
    }
    await this.caughtUp();
    if (status) refused(status);
    return answer;
  },
  async draft() { // the first card, once the first plot is there: a draft looks at the whole flight
    const log = this.log();
    if (!log || this.session.card || this.drafting === log.id) return;
    this.drafting = log.id;
    await this.change("PUT", "/api/card", {draft: log.id, seen: 0});
  },
  async caughtUp() { // the session as it is now, however long the studio is silent
    for (;;) {
      try { return await this.refresh(); } catch { await new Promise(go => setTimeout(go, 1000)); }
    }
  },
  asking: Promise.resolve(),
  refresh() { // one at a time: no older answer follows a newer one
    this.asking = this.asking.catch(() => {}).then(() => this.ask());
    return this.asking;
  },
  async ask() {
    const seen = this.session ? `?seen=${this.session.revision}` : "";
    const found = await get(`/api/session${seen}`);
    const was = this.session;
    if (was && found.revision === was.revision) this.session = {...was, running: found.running, live: found.live};
    else this.session = found;
    if (!was && found.told) notice("warning", found.told);
    this.draw();
  },
  draw() {
    if (!this.session) return; // nothing was heard yet
    steps();
    running();
    const shown = step();
    for (const [name] of PAGES) document.getElementById(name).hidden = name !== shown;
    panels[shown].draw(studio);
    if (shown !== "logs" && shown !== "live") this.draft();
  },
  go(name) { location.hash = name; },
};

const panels = {};

function step() {
  const name = location.hash.slice(1).split("/")[0];
  return PAGES.some(([one]) => one === name) ? name : "logs";
}

function done(name) {
  const {uploads, card, problem, fits} = studio.session, ranges = uploads.flatMap(one => one.ranges);
  return {
    logs: uploads.length > 0, card: Boolean(card) && !problem, ranges: ranges.some(one => one.role === "train"),
    fit: fits.some(one => one.status === "done" && one.settings.kind === "fit"),
    compare: fits.some(one => one.status === "done" && one.settings.kind === "compare"),
    live: Boolean(studio.session.live?.running),
  }[name];
}

function steps() {
  const place = document.getElementById("steps"), shown = step();
  if (!place.children.length) {
    fill(place, PAGES.map(([name, words], i) => h("a", {href: `#${name}`, "data-step": name}, h("span", {className: "number", "aria-hidden": true}, i < STEPS.length ? String(i + 1) : "≈"), h("span", {className: "words"}, words))));
  }
  for (const link of place.children) {
    const current = link.dataset.step === shown;
    if (current) link.setAttribute("aria-current", "step"); else link.removeAttribute("aria-current");
    link.classList.toggle("done", Boolean(done(link.dataset.step)));
  }
}

function running() {
  const place = document.getElementById("running"), now = studio.session.running;
  place.hidden = !now;
  if (now) fill(place, h("a", {href: "#fit"}, h("progress", {max: 1, value: now.fraction, "aria-label": "Progress of the fit"}), ` ${Math.round(100 * now.fraction)} %`));
}

let silent = false;
async function watch() {
  try {
    await studio.refresh();
    if (silent) { silent = false; document.querySelector(".notice.lost")?.remove(); }
  } catch (error) {
    if (!silent) {
      silent = true;
      const line = error instanceof Refusal ? error.message : "The studio does not answer. Is it still running? Start it again with: rotorfit studio";
      notice("error", line).classList.add("lost");
    }
  }
  setTimeout(watch, document.hidden ? 4000 : studio.session?.running ? 400 : 1000);
}

addEventListener("hashchange", () => { cleared(); studio.draw(); document.getElementById("main").scrollIntoView({block: "start"}); });

studio.constants = await get("/api/constants").catch(error => { notice("error", error.message); throw error; });
panels.logs = logsPanel(document.getElementById("logs"), studio);
panels.card = cardPanel(document.getElementById("card"), studio);
panels.ranges = rangesPanel(document.getElementById("ranges"), studio);
panels.fit = fitPanel(document.getElementById("fit"), studio);
panels.compare = comparePanel(document.getElementById("compare"), studio);
panels.live = livePanel(document.getElementById("live"), studio);
document.documentElement.dataset.ready = "true";
watch();
