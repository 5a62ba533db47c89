"""The header of every export: contents, units, limits, validity, origin. It has no date and no name of a machine."""

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence

from rotorfit.core.finding import OTHER_STAMPS, Finding
from rotorfit.core.frames import AXES, POSE_UNITS
from rotorfit.core.laws import structure_named
from rotorfit.core.limits import WORLD_COMMANDS
from rotorfit.core.model import Axis, Interval
from rotorfit.exports.subject import Subject
from rotorfit.exports.validity import training_of

WIDTH = 112

FRAMES = (
    "Position x, y, z [m] and yaw [rad] in the world frame of the poses: z up, yaw counter-clockwise from x, not "
    "wrapped. Velocities are their rates. Commands u and accelerations c are in the heading frame: x forward, y left, "
    "z up, yaw counter-clockwise; it turns with the vehicle. A command holds until the next one."
)

DISTURBED = (
    "For an estimator, the disturbance as fitted: beside the commanded motion every axis has a slow velocity s with "
    "s'' = -alpha s' - kappa alpha^2 / 4 s + sqrt(q) xi, and white noise of variance r on the pose. wind_power is q "
    "[unit^2/s^5], wind_damping alpha [1/s], wind_overlap kappa, pose_variance r [unit^2], velocity_variance that of a "
    "measured velocity, trim_variance that of c [unit^2/s^4]; the unit is m, of yaw rad:"
)
"""Source: module `disturbance`."""


def header(
    subject: Subject, contents: str, trained: Mapping[str, Sequence[float]], scored: Sequence[str], mark: str
) -> tuple[str, ...]:
    """Lines of the header, without characters that could end a comment in any of the languages.

    Args:
        subject: What is exported.
        contents: What is in of the file, in a sentence or two.
        trained: As `validity.trained_on` gives it.
        scored: Lines about prediction errors.
        mark: The line that identifies the file as an export.
    """
    parts = [
        mark,
        "",
        f"Vehicle: {subject.model.card.name}.",
        *_wrapped(contents),
        "",
        "Laws, along each axis of the heading frame:",
        *(_row(axis, _law(subject, axis)) for axis in AXES),
        "",
        *_wrapped(FRAMES),
        *(_wrapped(WORLD_COMMANDS) if subject.model.card.command_frame == "world" else []),
        "",
        "Commands:",
        *(_row(axis, _command(subject, axis)) for axis in subject.axes),
        "",
        "Coefficients of the fit, with 95 % intervals of the vehicle, per command of the model file:",
        *(line for axis in subject.axes for line in _coefficients(axis, subject.original.axes[axis])),
        *(line for said in _of_stamps(subject.original.findings) for line in _wrapped(said, "  ")),
        "",
        "Validity, from the training flights:",
        *(_row(axis, training_of(subject, axis, trained)) for axis in subject.axes),
        "Validity, RMSE of predicted velocity up to a horizon and of the position at its end:",
        *(line for score in scored for line in _wrapped(score, "  ")),
        "",
        *_disturbance(subject),
        *(["Left out, rounded, scaled:"] if subject.notes else []),
        *(line for note in subject.notes for line in _wrapped(note, "  ")),
        *([""] if subject.notes else []),
        *_provenance(subject),
    ]
    return tuple(harmless(line).rstrip() for line in parts)


def harmless(text: str) -> str:
    """A line that cannot end a comment or a string in any of the languages: a card's name or a path may be anything."""
    plain = "".join(sign if sign.isprintable() else " " for sign in text)
    for sign, instead in (("\\", "/"), ('"', "'"), ("*/", "* /"), ("/*", "/ *"), ("$(", "$ ("), ("${", "$ {")):
        plain = plain.replace(sign, instead)
    return re.sub("-(?=-)", "- ", plain)  # "---" has "--" twice


def _wrapped(text: str, indent: str = "") -> list[str]:
    return textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent + "  " * bool(indent), break_on_hyphens=False
    )


def _row(axis: str, text: str) -> str:
    return f"  {axis:4} {text}"


def _law(subject: Subject, axis: str) -> str:
    if axis not in subject.axes:
        return "left out: it keeps its velocity"
    structure = subject.structure(axis)
    return f"{structure.law} ({structure.name})"


def _command(subject: Subject, axis: str) -> str:
    return subject.commands[AXES.index(axis)].text


def _coefficients(axis: str, known: Axis) -> Iterator[str]:
    structure, point, rate = structure_named(known.structure), known.predictor, f"{POSE_UNITS[axis]}/s"
    if point is None:
        return
    values = {"input": point.input, "damping": point.damping}
    values |= {"delay": point.delay} if structure.delayed else {}
    units = {"input": f"{rate}^2", "damping": "1/s", "delay": "s"}
    for extra in structure.extras:
        values[extra.name] = point.extra[extra.name]
        units[extra.name] = {"speed": rate, "acceleration": f"{rate}^2", "gain": f"{rate}^2", "command": ""}.get(
            extra.unit, extra.unit
        )
    for name, value in values.items():
        ends = f" ({_interval(known.ci95[name])})" if name in known.ci95 else ""
        yield _row(axis, f"{name} {value:.5g}{ends} {units[name]}").rstrip()


def _of_stamps(findings: Sequence[Finding]) -> Iterator[str]:
    """What commands that bear other stamps than their own leave unknown of the delays."""
    for effect in dict.fromkeys(finding.effect for finding in findings if finding.code in OTHER_STAMPS):
        yield f"of these logs, {effect}."


def _interval(ends: Interval) -> str:
    return " to ".join("open" if end is None else f"{end:.4g}" for end in ends)


def _disturbance(subject: Subject) -> Iterator[str]:
    """Lines on the disturbance: what an estimator can use, and what holds for the flights only."""
    noisy = {axis: subject.original.axes[axis].noise for axis in subject.axes if subject.original.axes[axis].noise}
    if noisy:
        yield from _wrapped(DISTURBED)
        for axis, noise in noisy.items():
            yield _row(axis, ", ".join(f"{name} {value:.3g}" for name, value in noise.items()))
    trims = {axis: [c for c in subject.original.axes[axis].trim if c is not None] for axis in subject.axes}
    if any(trims.values()):
        yield "Constant accelerations c of the training flights, which belong to each flight; in the export c is 0"
        yield "unless you give one [m/s^2, yaw rad/s^2]:"
        for axis, values in trims.items():
            yield _row(axis, ", ".join(f"{value:.3g}" for value in values))
    yield ""


def _provenance(subject: Subject) -> Iterator[str]:
    yield "Provenance:"
    yield f"  model    {subject.origin}"
    yield f"           sha256 {subject.sha256}"
    yield f"  fitted   by rotorfit {subject.original.rotorfit}, method {subject.original.method}"
    if subject.original.conversion:
        yield "  after    a conversion to other limits than those of its flights"
    for flight in subject.original.flights:
        start, end = flight.span
        axes = f" for {', '.join(flight.axes)}" if flight.axes else ""
        yield f"  flight   {flight.path}, {start:g} to {end:g} s{axes}"
        yield f"           sha256 {flight.sha256}"
