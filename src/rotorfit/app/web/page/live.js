// Beside the steps: a vehicle is followed while it flies. The page within is that of `rotorfit track --page`.

import {fill, h, labelled, options} from "./dom.js";

export function livePanel(place, studio) {
  const link = h("input", {type: "text", value: "sim", spellcheck: "false", size: 34}), card = h("select", {});
  const start = h("button", {type: "button", className: "primary", onclick: () => studio.change("POST", "/api/live", {link: link.value, card: card.value})}, "Follow");
  const stop = h("button", {type: "button", onclick: () => { stop.disabled = true; studio.change("DELETE", "/api/live"); }}, "End");
  const said = h("div", {className: "muted", role: "status"}), view = h("div", {});
  fill(place, h("h1", {id: "live-title"}, "Live"),
    h("p", {className: "lead"}, "The model of a vehicle while it flies, the wind, and an alarm when it is another vehicle. Nothing is commanded; what was heard becomes a log."),
    h("div", {className: "panel"},
      h("div", {className: "bar"}, labelled("Link", link, "field inline"), labelled("Card", card, "field inline"), start, stop),
      h("p", {className: "muted"}, "sim is a simulated vehicle, sim,wind=2,mass=1.3@40 one that takes up a load after 40 s in wind; ros1, ros2 and mavlink:udpin:127.0.0.1:14540 are real ones, which somebody else flies."),
      said), view);
  let framed = 0, offered = "";

  return {draw() {
    const {live, card: text} = studio.session, runs = Boolean(live?.running);
    const cards = [["", "what the link says itself"], ...(text ? [["session", "of this session"]] : []), ...Object.entries(studio.constants.cards).map(([name, words]) => [name, `${name} (${words})`])];
    if (offered !== JSON.stringify(cards)) { options(card, cards, card.value); offered = JSON.stringify(cards); }
    start.hidden = runs;
    stop.hidden = !runs;
    if (!runs) stop.disabled = false;
    stop.textContent = stop.disabled ? "Ending: a last fit" : "End";
    link.disabled = card.disabled = runs;
    const lines = live?.said ?? [];
    if (said.dataset.text !== lines.join("\n")) { said.dataset.text = lines.join("\n"); fill(said, lines.slice(-4).map(line => h("p", {}, line))); }
    if (live && framed !== live.number) {
      framed = live.number;
      fill(view, h("iframe", {className: "live", title: `The vehicle on ${live.link}`, src: "/live/"}));
    }
  }};
}
