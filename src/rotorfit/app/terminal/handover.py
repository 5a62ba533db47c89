"""Terminal output of exports (the formats, and what was written), and of gains (a table of numbers, one of margins)."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.text import Text

from rotorfit.app.terminal.tables import View, bullets, table, three_digits, title
from rotorfit.control.controller import STEPS
from rotorfit.control.trial import PathScore
from rotorfit.control.tuning import DELAY_SHARE, AxisTuning, Tuning
from rotorfit.core.card import Card
from rotorfit.core.limits import WORLD_COMMANDS, recorded_as
from rotorfit.exports import Export
from rotorfit.exports.formats import Format
from rotorfit.exports.gains import LAWS

MARGINS = "gain", "phase", "delay", "peak"

SMALLEST = 0.005
"""Factor on the gain below which, to two digits, none is too small."""


def export_formats_view(formats: Mapping[str, Format]) -> View:
    """Every format, with its contents and requirements."""
    out = table("--to", "file", "what it is", left=(0, 1, 2))
    for name, form in formats.items():
        out.add_row(name, form.suffix, Text(f"{form.text}; {form.needs}" if form.needs else form.text))
    yield out
    yield Text("rotorfit export model.json --to NAME -o FILE; docs/exports.md tells how exact each is.", style="dim")


def export_view(made: Export, where: str) -> View:
    """What was written, and what was left out."""
    yield Text(f"{made.format} for {', '.join(made.axes)}, named {made.name}, written to {where}.")
    yield from bullets(made.notes)


def export_mapping(made: Export, where: str) -> dict[str, Any]:
    """An export as plain JSON types, with the numbers."""
    points = {axis: made.model.axes[axis].predictor for axis in made.axes}
    return {
        "format": made.format,
        "path": where,
        "name": made.name,
        "axes": {
            axis: {
                "structure": made.model.axes[axis].structure,
                "input": point.input,
                "damping": point.damping,
                "delay": point.delay,
                **point.extra,
            }
            for axis, point in points.items()
            if point
        },
        "notes": list(made.notes),
    }


def tuning_view(tuning: Tuning, card: Card) -> View:
    """Gains, margins at the estimate and under its covariance, assumptions, refused axes, and what to send."""
    yield title(
        f"{tuning.kind}, {tuning.rate:g} commands a second, each from a fresh pose {1000 * tuning.latency:g} ms old"
    )
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
    margins = table("margins", *MARGINS, *(f"{name} 95" for name in MARGINS), "noise")
    for axis, one in tuning.axes.items():
        margins.add_row(axis, *_margins(one))
    yield margins
    draws = [one.robustness.draws for one in tuning.axes.values()]
    count = f"{min(draws)} to {max(draws)}" if len(set(draws)) > 1 else f"{draws[0]}"
    seed = next(iter(tuning.axes.values())).robustness.seed
    yield Text(
        f"Of the model itself, then what 95 % of {count} vehicles drawn from its covariance keep (seed "
        f"{seed}; none is unstable): gain: a factor, deg, s. peak: of the sensitivity; the delay margin must "
        f"be {DELAY_SHARE:g} of latency and delay. noise: what the poses' noise does to the command, "
        "% of full scale, or in its own unit where there is none.",
        style="dim",
    )
    yield from bullets([tuning.note] if tuning.note else [])
    yield from bullets([f"{axis}: {one.note}" for axis, one in tuning.axes.items() if one.note])
    yield from bullets([f"{axis}: no gains, {why}" for axis, why in tuning.refused.items()])
    yield from bullets([f"{axis}: u is the command{held}" for axis in tuning.axes if (held := recorded_as(card, axis))])
    yield from bullets([WORLD_COMMANDS] * (card.command_frame == "world"))


def trial_view(scores: Sequence[PathScore], address: str) -> View:
    """Tracking errors in the virtual flight room."""
    flights, age = scores[0].flights, 1e3 * scores[0].pose_age
    yield title(f"In the flight room: {address}, {flights} flights of each path, poses {age:.3g} ms old")
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
    """The size of the steps; empty without steps."""
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
    return [
        _factors(*around.gain),
        f"{math.degrees(around.phase):.0f}",
        _seconds(around.delay),
        f"{around.peak:.2f}",
        _factors(*believed.gain),
        f"{math.degrees(believed.phase):.0f}",
        _seconds(believed.delay),
        f"{believed.peak:.2f}",
        one.noise_text,
    ]


def _factors(low: float, high: float) -> str:
    """Factors on the gain; where any smaller one is stable, the largest alone."""
    most = f"{high:.2f}" if math.isfinite(high) else "none"
    return most if low < SMALLEST else f"{low:.2f} to {most}"


def _seconds(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "none"
