"""The paper's manoeuvre under feedback: estimates of the paper's regression and of the likelihood.

    python bench/bench_ident.py [FLIGHTS]

drone_dev tracks position references (`rotorfit plan --design ident`): every command responds to the measured pose.
Flown in the virtual flight room (Bebop 2, gusts of 0.2 m/s, seeds from 1) and by the paper's own equation (the same
plan, the same seeds). Fitted is the law whose coefficients the truth states, `first_order_delay`. Mean and standard
deviation of the estimates with the truth, and how often the interval of the flight holds it; written to ident.json
beside this file.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from rotorfit.app.workflows import load_flight
from rotorfit.core.flight_data import Flight
from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import WHOLE, LogSpan
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.links.opening import open_link, simulated_at
from rotorfit.flying.mission import attached_to
from rotorfit.flying.preflight import preflight
from rotorfit.flying.recorder import record
from rotorfit.planning.belief import belief_from_card
from rotorfit.planning.plan_control import tracker_of
from rotorfit.planning.plan_flight import plan_flight
from rotorfit.planning.precision import fly_plan, recorded_flight
from rotorfit.planning.request import space_of_room
from rotorfit.simulation.paper_vehicle import Truth
from rotorfit.simulation.vehicle import load_vehicle

VEHICLE, AIR, ROOM, DURATION = "bebop2", "gusts=0.2", "6x6x4", 120.0


def ident_plan() -> Plan:
    card = card_from_mapping(load_vehicle(VEHICLE).card(), VEHICLE)
    return plan_flight(card, space_of_room(ROOM), "ident", AXES, DURATION, belief_from_card(card))


def in_the_room(plan: Plan, seed: int) -> Flight:
    """As `rotorfit fly` records it and `rotorfit fit` reads it."""
    name = f"sim:{VEHICLE},{AIR}"
    link = open_link(simulated_at(name, plan.space.start, seed), card_from_mapping(plan.card, VEHICLE))
    with TemporaryDirectory() as folder:
        path = Path(folder, "flight.mcap")
        result = fly(plan, link, record(path, attached_to(plan, preflight(plan, link), name)), land=False)
        assert result.reason == "completed", result.text
        return load_flight(LogSpan(str(path), WHOLE))


def by_the_equation(plan: Plan, seed: int) -> Flight:
    linear = load_vehicle(VEHICLE).linear()
    return recorded_flight(fly_plan(tracker_of(plan), Truth(gamma=linear.gamma, delay=linear.delay), seed))


def table(models: Sequence[Model], truth: Sequence[float]) -> dict[str, dict[str, float | None]]:
    """Coefficient to truth, mean and standard deviation by both methods, and how often the interval holds the truth."""
    out: dict[str, dict[str, float | None]] = {}
    for k, axis in enumerate(AXES):
        for i, name in enumerate(COEFFICIENTS):
            known = [value for m in models if (value := getattr(m.axes[axis], name)) is not None]
            ends = [m.axes[axis].ci95_flight[name] for m in models]
            here = truth[3 * k + i]
            inside = [(a is None or a <= here) and (b is None or here <= b) for a, b in ends]
            paper = [m.paper[2 * k + i] for m in models] if i < 2 else [None]
            has = [value for value in paper if value is not None]
            out[f"{axis}.{name}"] = {
                "truth": here,
                "ml": float(np.mean(known)) if known else None,
                "ml_sd": float(np.std(known)) if known else None,
                "numbers": len(known),
                "inside": float(np.mean(inside)),
                "paper": float(np.mean(has)) if has else None,
                "paper_sd": float(np.std(has)) if has else None,
            }
    return out


def show(title: str, rows: dict[str, dict[str, float | None]], flights: int) -> None:
    print(f"\n{title}, {flights} flights")
    print(f"{'':14}{'truth':>9}{'ml':>9}{'+-':>8}{'numbers':>9}{'inside':>8}{'paper':>9}{'+-':>8}")
    for name, row in rows.items():
        number = lambda key, digits=3, row=row: "-" if row[key] is None else f"{row[key]:.{digits}f}"  # noqa: E731
        print(
            f"{name:14}{number('truth'):>9}{number('ml'):>9}{number('ml_sd'):>8}{number('numbers', 0):>9}"
            f"{number('inside', 2):>8}{number('paper'):>9}{number('paper_sd'):>8}"
        )


def main() -> None:
    flights = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    plan, linear = ident_plan(), load_vehicle(VEHICLE).linear()
    truth = [value for k in range(4) for value in (linear.gamma[2 * k], linear.gamma[2 * k + 1], linear.delay[k])]
    result = {}
    for title, source in (("the paper's equation", by_the_equation), ("virtual flight room", in_the_room)):
        rows = table(
            [fit([source(plan, seed)], structure="first_order_delay").model for seed in range(1, flights + 1)], truth
        )
        show(title, rows, flights)
        result[title] = rows
    path = Path(__file__).with_name("ident.json")
    path.write_text(json.dumps({"flights": flights, "tables": result}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
