"""Is a flight as precise as its plan predicted, and how much more precise is an optimal design than the paper's sines?

    python bench/bench_plans.py [FLIGHTS] [--designs two_sines,optimal_d,...] [-o FILE]

Every design flies 60 s on x, y and z together and 60 s on yaw, FLIGHTS (default 100) times, with the demo's vehicle
(set B, delay 0.15 s, light wind, 0.5 mm mocap, 8 % stale frames; seeds 1 to FLIGHTS for x, y, z, from 10,001 on for
yaw; the same wind and noise for every design). The room is 4 m by 4 m by 2 m, the speed at most 1.5 m/s along x and y
each, the climb 1 m/s, a command at most half of full scale, yaw at most 1 rad from its start and 1 rad/s. The bands of
frequencies and the smoothing of the optimal commands are the planner's (`planning.fastest`).

In open loop the wind alone would carry this vehicle out of such a room within 60 s (`hover` below), so all designs are
flown with the planner's soft centring feedback, except `two_sines_paper`, which is flown as in the paper, in open loop
and at the paper's amplitude, without a limit of room. The room that the wind takes in 19 of 20 hovers is reserved.
Every other signal is made as large, axis by axis, as the rest of the room, the speed and the command allow for the
likeliest vehicle in still air. A flight starts such that its path is in the middle of the room. `ident` is a position
reference under its own feedback.

Per coefficient: the standard error predicted by the plan (`precision`, one flight of the likeliest vehicle), the root
mean square error over the flights, the mean standard error of the fits, and the ratios of the last two to the first.
Results: bench/plans.json.
"""

import argparse
import json
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from rotorfit.core.flight_plan import AxisExcitation, Feedback, Plan, Sines, Space
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS, STRUCTURE, Axis
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import builtin_cards
from rotorfit.planning.belief import Belief
from rotorfit.planning.envelope import fleet_of, predicted_path
from rotorfit.planning.optimal import AxisLimits, Criterion, optimal_excitations
from rotorfit.planning.plan_control import tracker_of
from rotorfit.planning.plan_flight import fastest
from rotorfit.planning.precision import fly_plan, path, predicted_errors, recorded_flight
from rotorfit.planning.signals import designed, ident_reference, paper_sines, scaled
from rotorfit.simulation.paper_vehicle import Truth, noise_free

DURATION = 60.0
TRUTH = Truth()
BELIEF = Belief(TRUTH, np.zeros((12, 12)), (0.0,) * 4)
SPACE = Space((-2.0, -2.0, 1.0), (2.0, 2.0, 3.0), (0.0, 0.0, 2.0, 0.0), speed=1.5, climb=1.0)
HALF = {"x": 2.0, "y": 2.0, "z": 1.0, "yaw": 1.0}
"""Half the room [m]; how far yaw may turn [rad]."""
SPEED = {"x": 1.5, "y": 1.5, "z": 1.0, "yaw": 1.0}
COMMAND = 0.5
SLOWEST = 0.6
"""Where the bands of the classic designs begin [rad/s]."""
RAMP = 1.0
"""Of all designs but the optimal ones, which start and end at 0 by themselves [s]."""
GROUPS = (("x", "y", "z"), ("yaw",))
DESIGNS = (
    "two_sines_paper", "two_sines", "multisine", "chirp", "doublets", "3211", "prbs", "optimal_d", "optimal_a", "ident"
)  # fmt: skip
CENTRING = Feedback(AXES, (0.3, 0.3, 0.6, 0.6), (0.5, 0.5, 1.0, 1.0))
IDENT = Feedback(AXES, (1.33, 1.40, 3.50, 1.75), (1.50, 1.50, 2.00, 2.00))
"""Source: jrsbenevides/drone_dev, config/bebopParameters.yaml, KpFL and KdFL."""
FAR = 0.25
"""A ratio further from 1 than this needs an explanation."""


def plan_of(design: str, excitations: Sequence[AxisExcitation], feedback: Feedback | None = None) -> Plan:
    return Plan(
        name=design, design=design, card=builtin_cards()["rotorfit-demo"].raw, rate=TRUTH.command_rate,
        duration=DURATION, ramp=0.0 if design.startswith("optimal") else RAMP, excitations=tuple(excitations),
        feedback=feedback, space=SPACE, belief={"gamma": list(TRUTH.gamma)},
    )  # fmt: skip


def feedback_of(design: str) -> Feedback | None:
    return {"two_sines_paper": None, "ident": IDENT}.get(design, CENTRING)


def drift(feedback: Feedback | None) -> Array:
    """How far from its start the wind carries a hover of 60 s, on x, y, z, yaw: 39 of 40 to either side."""
    rest = AxisExcitation("x", "command", 0.0, DURATION, Sines((0.0,), (1.0,), (0.0,)))
    extent = predicted_path(plan_of("hover", [rest], feedback), fleet_of(BELIEF, TRUTH.command_rate, DURATION)).extent
    return np.asarray(np.abs(extent - np.array(SPACE.start)).max(axis=0))


def largest(plan: Plan, axis: str, room: float) -> float:
    """The factor on the signal of an axis with which it uses up room, speed or command."""
    a = AXES.index(axis)
    flight = fly_plan(tracker_of(plan), noise_free(TRUTH), 0)
    width = float(np.ptp(flight.true_pose[:, a])) / 2
    use = (
        width / room,
        np.abs(flight.velocity[:, a]).max() / SPEED[axis],
        np.abs(flight.command[:, a]).max() / COMMAND,
    )
    return 1 / float(max(use))


def excitations_of(design: str, group: Sequence[str], room: dict[str, float]) -> list[AxisExcitation]:
    """The signals of a group of axes, as large as they may be."""
    feedback = feedback_of(design)
    if design.startswith("optimal"):
        limits = {axis: AxisLimits(COMMAND, -room[axis], room[axis], SPEED[axis]) for axis in group}
        smooth = {axis: 2 * np.pi / fastest(BELIEF, axis) for axis in group}
        criterion: Criterion = "a" if design == "optimal_a" else "d"
        return list(optimal_excitations(BELIEF, limits, 0.0, DURATION, feedback, criterion, smooth=smooth))
    out = []
    for place, axis in enumerate(group):
        band = (SLOWEST, fastest(BELIEF, axis))
        if design == "ident":
            one = AxisExcitation(axis, "position", 0.0, DURATION, ident_reference(axis))
        elif design.startswith("two_sines"):
            one = AxisExcitation(axis, "command", 0.0, DURATION, paper_sines(axis))
        else:
            one = AxisExcitation(
                axis, "command", 0.0, DURATION, designed(design, 0.1, DURATION, band, place, len(group))
            )
        if design != "two_sines_paper":
            factor = largest(plan_of(design, [one], feedback), axis, room[axis])
            one = replace(one, signal=scaled(one.signal, factor))
        out.append(one)
    return out


def plans_of(design: str, room: dict[str, float]) -> list[Plan]:
    """The two flights of a design, each started where its path lies in the middle of the room."""
    return [centred(plan_of(design, excitations_of(design, group, room), feedback_of(design))) for group in GROUPS]


def centred(plan: Plan) -> Plan:
    nominal = path(plan, fly_plan(tracker_of(plan), noise_free(TRUTH), 0))[:, :3]
    x, y, z = (np.array(SPACE.lower) + SPACE.upper - nominal.min(axis=0) - nominal.max(axis=0)) / 2 + SPACE.start[:3]
    return replace(plan, space=replace(SPACE, start=(float(x), float(y), float(z), 0.0)))


def fitted(job: tuple[Sequence[Plan], int]) -> tuple[dict[str, list[float | str | None]], bool]:
    """Flies and fits once: per coefficient the estimate, its standard error, its interval's ends and its status.

    Beside them, whether the flight of x, y, z stayed in the room.
    """
    plans, number = job
    flights = [fly_plan(tracker_of(plan), TRUTH, number + 10_000 * k) for k, plan in enumerate(plans)]
    where = path(plans[0], flights[0])[:, :3]
    inside = bool(np.all((where >= SPACE.lower) & (where <= SPACE.upper)))
    out: dict[str, list[float | str | None]] = {}
    for flight, group in zip(flights, GROUPS, strict=True):
        model = fit([recorded_flight(flight)], axes=group, structure=STRUCTURE).model
        for axis in group:
            one = model.axes[axis]
            for name in COEFFICIENTS:
                out[f"{axis}.{name}"] = [
                    getattr(one, name),
                    _of_flight(one, name),
                    *one.ci95_flight[name],
                    one.status[name],
                ]
    return out, inside


def _of_flight(axis: Axis, name: str) -> float | None:
    """Standard error of a coefficient as these flights leave it: plans and flights are compared, not vehicles."""
    ends, error = (*axis.ci95[name], *axis.ci95_flight[name]), axis.stderr[name]
    if error is None or None in ends:
        return None
    low, high, least, most = ends
    return error * (most - least) / (high - low)


def truths() -> dict[str, float]:
    table = np.column_stack([TRUTH.gamma[::2], TRUTH.gamma[1::2], TRUTH.delay])
    return {f"{axis}.{name}": float(table[a, c]) for a, axis in enumerate(AXES) for c, name in enumerate(COEFFICIENTS)}


def rows_of(
    plans: Sequence[Plan], found: Sequence[dict[str, list[float | str | None]]]
) -> dict[str, dict[str, float | int | None]]:
    """Predicted against achieved, per coefficient."""
    promised = predicted_errors(plans, BELIEF, draws=0, seed=90_000, of_vehicle=False).nominal
    rows: dict[str, dict[str, float | int | None]] = {}
    for key, true in truths().items():
        axis, name = key.split(".")
        predicted = promised[axis][name]
        told = [one[key] for one in found if one[key][4] == "ok"]
        error = np.array([float(one[0]) - true for one in told])  # type: ignore[arg-type]
        inside = [one[2] <= true <= one[3] for one in told]  # type: ignore[operator]
        n = error.size
        rms = float(np.sqrt(np.mean(error**2))) if n else None
        stated = float(np.mean([float(one[1]) for one in told])) if n else None  # type: ignore[arg-type]
        rows[key] = {
            "predicted": predicted, "rms": rms, "stated": stated, "bias": float(error.mean()) if n else None,
            "achieved_ratio": rms / predicted if rms else None, "stated_ratio": stated / predicted if stated else None,
            "covered": float(np.mean(inside)) if n else None, "n": n, "missing": len(found) - n,
        }  # fmt: skip
    return rows


def chance(n: int) -> tuple[float, float]:
    """95 % of the ratios of RMS error to standard error lie in here where nothing is wrong."""
    low, high = np.sqrt(chi2.ppf([0.025, 0.975], n) / n)
    return float(low), float(high)


def print_rows(title: str, rows: dict[str, dict[str, float | int | None]]) -> None:
    print(f"\n{title}")
    print(
        f"{'coefficient':14}{'predicted':>11}{'rms':>11}{'stated':>11}{'rms/pred':>10}{'stated/pred':>12}{'covered':>9}{'missing':>9}"
    )
    for key, row in rows.items():
        cells = "".join(
            f"{row[k]:11.3g}" if row[k] is not None else f"{'-':>11}" for k in ("predicted", "rms", "stated")
        )
        ratios = "".join(
            f"{row[k]:11.2f}" if row[k] is not None else f"{'-':>11}"
            for k in ("achieved_ratio", "stated_ratio", "covered")
        )
        far = row["achieved_ratio"] is None or abs(float(row["achieved_ratio"]) - 1) > FAR
        print(f"{key:14}{cells}{ratios}{row['missing']:9d}{'  far' if far else ''}")


def print_gains(designs: dict[str, object]) -> None:
    """By how much intervals shrink against the two sines in the same room: predicted, and achieved where known."""
    print("\nstandard errors of the two sines in the same room over those of each design: predicted (achieved)")
    print(f"{'coefficient':14}" + "".join(f"{design:>18}" for design in designs))
    for key in truths():
        cells = []
        for design in designs:
            ours, theirs = (designs[each]["coefficients"][key] for each in (design, "two_sines"))  # type: ignore[index]
            achieved = f"{theirs['rms'] / ours['rms']:.1f}" if ours["rms"] and theirs["rms"] else "-"
            cells.append(f"{theirs['predicted'] / ours['predicted']:.1f} ({achieved})")
        print(f"{key:14}" + "".join(f"{cell:>18}" for cell in cells))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("flights", nargs="?", type=int, default=100)
    parser.add_argument("--designs", default=",".join(DESIGNS))
    parser.add_argument("-o", dest="output", type=Path, default=Path(__file__).with_name("plans.json"))
    options = parser.parse_args()
    free, held = drift(None), drift(CENTRING)
    room = {axis: HALF[axis] - float(held[a]) for a, axis in enumerate(AXES)}
    for name, far in (("open loop", free), ("centred", held)):
        print(f"hover, {name}: the wind carries x, y, z, yaw as far as {np.array2string(far, precision=2)}")
    result: dict[str, object] = {
        "flights": options.flights,
        "drift": {"open": free.tolist(), "centred": held.tolist()},
        "room": room,
        "chance": chance(options.flights),
    }
    designs: dict[str, object] = {}
    with ProcessPoolExecutor(1) as pool:
        for design in options.designs.split(","):
            start = time.perf_counter()
            plans = plans_of(design, room)
            planned = time.perf_counter() - start
            flights = list(pool.map(fitted, [(plans, number) for number in range(1, options.flights + 1)]))
            rows = rows_of(plans, [found for found, _ in flights])
            inside = float(np.mean([stayed for _, stayed in flights]))
            designs[design] = {"inside": inside, "coefficients": rows}
            print_rows(
                f"{design}: planned in {planned:.0f} s, {time.perf_counter() - start:.0f} s in all, "
                f"{100 * inside:.0f} % of the flights stay in the room",
                rows,
            )
            result["designs"] = designs
            options.output.write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")
    low, high = chance(options.flights)
    print(f"\nratios of {options.flights} flights scatter from {low:.2f} to {high:.2f} (95 %)")
    if "two_sines" in designs:
        print_gains(designs)


if __name__ == "__main__":
    main()
