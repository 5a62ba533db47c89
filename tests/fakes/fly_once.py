"""Flies a plan in the flight room itself, in simulated time, with the sensors of a fake vehicle: PLAN VEHICLE FAKE OUT."""

import json
import sys
from dataclasses import asdict
from pathlib import Path

import tomli_w

from rotorfit.card import card_from_mapping
from rotorfit.fly import fly
from rotorfit.links import open_link
from rotorfit.plan_file import load_plan, plan_text
from rotorfit.preflight import preflight, refuse
from rotorfit.recorder import card_as_recorded, record


def main(plan_path: str, link_text: str, out: str) -> None:
    plan = load_plan(plan_path)
    card = card_from_mapping(plan.card, plan.name)
    link = open_link(link_text, card, plan.space.start, plan.seed, True)
    try:
        ready = preflight(plan, link)
        for check in ready.checks:
            print(check, file=sys.stderr)
        print(ready.notes, file=sys.stderr)
        refuse(ready)
        recorded = tomli_w.dumps(card_as_recorded(plan.card, ready.pose_clock))
        flown = fly(plan, link, record(out, {"plan": plan_text(plan), "card": recorded, "link": link_text}), land=False)
    finally:
        link.act("close")
    print(json.dumps(asdict(flown) | {"path": str(Path(out))}))


if __name__ == "__main__":
    main(*sys.argv[1:])
