"""Terminal output of a plan (signals, predicted path, predicted accuracy), and of the demo (truth beside estimates)."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from rotorfit.app.demo import Demo, recovered, scores
from rotorfit.app.terminal.tables import View, bullets, indented, table, three_digits, title
from rotorfit.assessment.rows import SPEED
from rotorfit.core.display import interval_text, number_text
from rotorfit.core.flight_plan import AxisExcitation, Chirp, Plan, Signal, Sines, value
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, Interval
from rotorfit.planning.next_flight import NextFlight
from rotorfit.planning.preview import EXPECTED_HEADS, UNDER_ONE_LAW, UNITS, expected_rows
from rotorfit.planning.run_on import run_on


def plan_view(plan: Plan) -> View:
    """One plan."""
    yield title(
        f"{plan.name}: {plan.duration:g} s, {plan.rate:g} commands a second, for {plan.card.get('name', 'a card')}"
    )
    yield indented(f"Believed: {plan.belief.get('source', 'nothing')}.")
    yield indented(_loop(plan))
    yield ""
    yield _signals(plan)
    yield ""
    yield _motion(plan)
    yield ""
    yield _errors(plan)
    yield from bullets([UNDER_ONE_LAW, *plan.predicted.get("notes", ()), *plan.belief.get("notes", ())])
    yield from bullets(_run_on(plan))
    yield Text(
        f"+-: half of the 95 % interval expected of a fit to this flight alone, over {plan.predicted['vehicles']} "
        f"vehicles that are believed possible. Middle 95 %: of {plan.predicted['draws']} of them, with wind and trim; "
        f"2.5 % reach further down, 2.5 % further up. {_leaving(plan)}",
        style="dim",
    )


def _loop(plan: Plan) -> str:
    """The feedback, in a sentence."""
    if plan.feedback is None:
        return "Open loop: nothing holds the vehicle back."
    excited = {each.axis for each in plan.excitations}
    tracked = {each.axis for each in plan.excitations if each.target == "position"}
    held = [axis for axis in plan.feedback.axes if axis not in excited]
    parts = [
        f"{word} {', '.join(axes)}"
        for word, axes in (
            ("tracks", [axis for axis in plan.feedback.axes if axis in tracked]),
            ("centres", [axis for axis in plan.feedback.axes if axis in excited - tracked]),
            ("holds", held),
        )
        if axes
    ]
    return f"Feedback on the measured pose {'; '.join(parts)}."


RUN_ON = (0.5, 1.0, 3.0)
"""How long vehicles keep executing the last command, as `rotorfit fly` gets it from the link: the Bebop's driver and
the flight room, PX4's default, ArduPilot's default [s]."""


def _run_on(plan: Plan) -> list[str]:
    """How far the vehicle runs on when commands stop at the worst instant."""
    if "covariance" not in plan.belief:
        return []
    parts = []
    for seconds in RUN_ON:
        far = run_on(plan, seconds)
        where = f", {far.outside:.1f} m outside of the box" if far.outside else ""
        parts.append(f"{seconds:g} s: {far.sideways:.1f} m sideways, {far.upright:.1f} m up or down{where}")
    return [f"if commands stop at the worst instant and the vehicle follows the last one for {'; '.join(parts)}"]


def _signals(plan: Plan) -> Table:
    """Table of the signals."""
    shown = table("axis", "signal", "largest", "frequencies", "crest", "of full", "from", "to", left=(0, 1), gap=3)
    crest, amplitude = plan.predicted.get("crest_factor", {}), plan.predicted.get("amplitude", {})
    for each in plan.excitations:
        factor = amplitude.get(each.axis)
        shown.add_row(
            each.axis,
            f"{_kind(each.signal)} of the {each.target}",
            f"{peak(each):.3g}{_unit(each)}",
            _frequencies(each.signal),
            f"{crest[each.axis]:.2f}" if each.axis in crest else "",
            "" if factor is None else f"{factor:.2f}",
            f"{each.start:.3g} s",
            f"{each.start + each.duration:.3g} s",
        )
    return shown


def _unit(excitation: AxisExcitation) -> str:
    if excitation.target == "command":
        return ""
    return " rad" if excitation.axis == "yaw" else " m"


def peak(excitation: AxisExcitation) -> float:
    """Largest value that a signal takes, without its ramps."""
    return float(np.max(np.abs(value(excitation.signal, np.arange(0.0, excitation.duration, 0.005)))))


def _kind(signal: Signal) -> str:
    if isinstance(signal, Sines):
        return f"{len(signal.frequency)} sines"
    return "sweep" if isinstance(signal, Chirp) else f"{len(signal.level) - 1} levels"


def _frequencies(signal: Signal) -> str:
    if isinstance(signal, Sines | Chirp):
        return f"{min(signal.frequency):.2f} to {max(signal.frequency):.2f} rad/s"
    gaps = [b - a for a, b in zip(signal.time, signal.time[1:], strict=False)]
    least, most = (f"{length:.2g}" for length in (min(gaps, default=0.0), max(gaps, default=0.0)))
    return (f"{most} s each" if least == most else f"{least} to {most} s each") if gaps else ""


def _motion(plan: Plan) -> Table:
    """Table of the path and the speeds with their limits."""
    shown = table("motion", "middle 95 %", "allowed", gap=3)
    extent, space = plan.predicted["extent"], plan.space
    for axis, low, high in zip(AXES[:3], space.lower, space.upper, strict=True):
        shown.add_row(f"{axis} [m]", _range(*extent[axis]), _range(low, high))
    shown.add_row("yaw [deg]", _range(math.degrees(extent["yaw"][0]), math.degrees(extent["yaw"][1]), 0), "")
    high = plan.predicted["speed_high"]
    shown.add_row("speed along x, y [m/s]", f"{high['horizontal']:.2f}", f"{space.speed:.2f}")
    shown.add_row("speed along z [m/s]", f"{high['vertical']:.2f}", f"{space.climb:.2f}")
    shown.add_row("rate of yaw [deg/s]", f"{math.degrees(high['yaw']):.0f}", "")
    return shown


def _leaving(plan: Plan) -> str:
    """The share of vehicles that leave the space, and on which sides; all may do so on one side."""
    draws, share = plan.predicted["draws"], plan.predicted["leaving"]
    ends = zip(AXES[:3], plan.space.lower, plan.space.upper, strict=True)
    sides = [
        f"{word} {axis}"
        for axis, lower, upper in ends
        for word, past in (
            ("low", plan.predicted["extent"][axis][0] < lower),
            ("high", plan.predicted["extent"][axis][1] > upper),
        )
        if past
    ]
    where = f", at {' and '.join(sides)} at least" if sides else ""
    return (
        f"{round(share * draws)} of {draws} leave what is allowed{where}; {100 * plan.predicted['allowed']:.0f} % may."
    )


def _range(low: float, high: float, digits: int = 2) -> str:
    return f"{low:.{digits}f} to {high:.{digits}f}"


def _errors(plan: Plan) -> Table:
    """Table of the belief, and of the accuracy that the flight will give."""
    shown = table("this flight tells", *EXPECTED_HEADS, gap=3)
    for row in expected_rows(plan):
        shown.add_row(*row)
    return shown


def next_view(proposal: NextFlight) -> View:
    """Why this flight is proposed, and what it improves."""
    yield title("Next flight")
    yield indented(f"{proposal.reason}.")
    if len(proposal.tried) > 1:
        left = ", ".join(
            f"{name} {value:.2g}" for name, value in sorted(proposal.tried.items(), key=lambda each: each[1])
        )
        yield indented(
            "What each design would leave, standard error over target, root mean square over their coefficients "
            f"(1: on target; less is better): {left}."
        )
    yield ""
    shown = table("standard error", "before", "after", "target", gap=3)
    for name, before, after, wanted in _rows(proposal):
        shown.add_row(name, *(three_digits(value) for value in (before, after, wanted)))
    yield shown
    yield indented("before: the model's; after: with this flight fitted as well", 0, "dim")
    yield ""


def _rows(proposal: NextFlight) -> Iterator[tuple[str, float, float, float]]:
    for axis in AXES:
        if axis in proposal.plan.card["command"]:
            for name, unit in zip(COEFFICIENTS, UNITS, strict=True):
                yield (
                    f"{axis} {name}{unit}",
                    proposal.before[axis][name],
                    proposal.after[axis][name],
                    proposal.wanted[axis][name],
                )


def demo_view(demo: Demo) -> View:
    """Truth beside the estimates, errors on the validation flights, and what was written."""
    out = table("axis", "coefficient", "truth", "likelihood", "95 % interval", "", "paper's method", left=(0, 1, 5))
    rows = recovered(demo)
    for row in rows:
        axis, _, name = row.name.partition(".")
        out.add_row(
            axis if name == "input" else "",
            name,
            f"{row.truth:.4g}",
            "-" if row.ml is None else number_text(row.ml, row.ci95),
            interval_text(row.ci95),
            "" if _inside(row.truth, row.ci95) else "missed",
            "-" if row.paper is None else f"{row.paper:.3g}",
        )
    stated = [row for row in rows if row.ci95 != (None, None)]
    inside = sum(_inside(row.truth, row.ci95) for row in stated)
    yield title("Six simulated flights, three to fit and three for the proof. What came back:")
    yield out
    units = "input in m/s^2 (yaw rad/s^2) per command of 1, damping in 1/s, delay in s"
    yield indented(f"{units}; --structure first_order_delay", 0, "dim")
    yield indented(
        f"{inside} of {len(stated)} intervals contain the truth; over many flights, at least 95 % should.", 0
    )
    yield ""
    yield title("1 s predictions of the velocity on flights that were not fitted:")
    errors = table("axis", "likelihood", "paper's method", "velocity held", "flight", left=(0, 4))
    for score in scores(demo):
        scale = SPEED[score.axis][1]
        cells = ["-" if v is None else three_digits(scale * v) for v in (score.ml, score.paper, score.hold)]
        errors.add_row(score.axis, *cells, Path(score.path).name)
    yield errors
    yield indented("RMSE in cm/s (yaw deg/s); a velocity that is held is the naive prediction", 0, "dim")
    yield ""
    yield title("Written:")
    yield from bullets([str(path) for path in demo.written])


def _inside(value: float, interval: Interval) -> bool:
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)
