"""What the terminal shows of gains: a table of the numbers, a table of the margins."""

import math
from collections.abc import Sequence

import numpy as np
from rich.text import Text

from rotorfit.gains_file import LAWS
from rotorfit.reference_paths import STEPS
from rotorfit.terminal.tables import View, bullets, table, three_digits, title
from rotorfit.trial import PathScore
from rotorfit.tune import DELAY_SHARE, AxisTuning, Tuning


def tuning_view(tuning: Tuning) -> View:
    """Gains, margins of the model itself and under its covariance, what had to be assumed, and what is refused."""
    yield title(f"{tuning.kind}, {tuning.rate:g} commands a second, poses {1000 * tuning.latency:g} ms old")
    yield Text(LAWS[tuning.kind], style="dim")
    observed = any(one.law.observer for one in tuning.axes.values())
    last = ("observer",) if observed else ("integral", "filter")
    gains = table("axis", "bandwidth", "input", "damping", "delay", "stiffness", "rate gain", *last)
    for axis, one in tuning.axes.items():
        gains.add_row(axis, *_gains(one))
    yield gains
    yield Text(
        "b: damping, K: stiffness, D: rate gain"
        + ("; d: by the observer. " if observed else ", I: integral. ")
        + "rad/s, m/s^2 or rad/s^2 per command, 1/s, s, 1/s^2, 1/s"
        + ("; observer: 1, 1/s, 1/s^2" if observed else "; integral: 1/s^3, filter: s"),
        style="dim",
    )
    yield ""
    margins = table("margins", "gain", "phase", "delay", "peak", "phase 95", "delay 95", "peak 95", "noise")
    for axis, one in tuning.axes.items():
        margins.add_row(axis, *_margins(one))
    yield margins
    draws = next(iter(tuning.axes.values())).robustness
    yield Text(
        f"Of the model itself, then what 95 % of {draws.draws} vehicles drawn from its covariance keep (seed "
        f"{draws.seed}; none is unstable): deg, s. peak: of the sensitivity; the delay margin must be "
        f"{DELAY_SHARE:g} of latency and delay. noise: what the poses' noise does to the command, % of full scale.",
        style="dim",
    )
    yield from bullets([f"{axis}: {one.note}" for axis, one in tuning.axes.items() if one.note])
    yield from bullets([f"{axis}: no gains, {why}" for axis, why in tuning.refused.items()])


def trial_view(scores: Sequence[PathScore], address: str) -> View:
    """Tracking errors in the virtual flight room."""
    flights = scores[0].flights
    yield title(f"In the flight room: {address}, {flights} flights of each path")
    shown = table("path", "m/s", "position", "heading", "overshoot", "settled", "saturated", "left the fence")
    for one in scores:
        error, steps = one.error, one.path.shape == "steps"
        lost = one.failed > one.flights / 2
        shown.add_row(
            one.path.shape,
            "-" if steps else f"{one.path.speed:.2f}",
            "-" if lost else three_digits(100 * error.position),
            "-" if lost else three_digits(math.degrees(error.heading)),
            "-" if lost or error.overshoot is None else f"{100 * error.overshoot:.0f} %",
            "-" if lost or error.settling is None else f"{error.settling:.2f}",
            f"{100 * one.saturated:.1f} %",
            f"{one.failed} of {one.flights}",
        )
    yield shown
    yield Text(f"RMS errors, medians over the flights: cm, deg, s. {_steps(scores)}", style="dim")


def _steps(scores: Sequence[PathScore]) -> str:
    """How large the steps are; empty without."""
    sizes = [one.path.size for one in scores if one.path.shape == "steps"]
    if not sizes:
        return ""
    x, y, z, yaw = np.abs(np.diff(np.array(STEPS), axis=0, prepend=np.zeros((1, 4))))[:-1].max(axis=0).tolist()
    size = sizes[0]
    return (
        f"Steps, not announced: x {size * x:g} m, y {size * y:g} m, z {size * z:g} m, yaw {math.degrees(yaw):.0f} deg, "
        "then all of it back."
    )


def _gains(one: AxisTuning) -> list[str]:
    law = one.law
    last = (
        [" ".join(three_digits(value) for value in law.observer)]
        if law.observer
        else [three_digits(law.integral), f"{law.filter_time:g}"]
    )
    numbers = [one.bandwidth, law.input, law.damping, law.delay, law.stiffness, law.rate]
    return [*(f"{value:.3g}" for value in numbers), *last]


def _margins(one: AxisTuning) -> list[str]:
    around, believed = one.margins, one.robustness
    low, high = around.gain
    return [
        f"{low:.2f} to {high:.2f}" if math.isfinite(high) else f"{low:.2f} up",
        f"{math.degrees(around.phase):.0f}",
        _seconds(around.delay),
        f"{around.peak:.2f}",
        f"{math.degrees(believed.phase):.0f}",
        _seconds(believed.delay),
        f"{believed.peak:.2f}",
        "-" if one.noise is None else f"{100 * one.noise:.1f}",
    ]


def _seconds(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "none"
