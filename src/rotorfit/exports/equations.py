"""The law of every axis as an expression in a programming language, without the terms that the axis does not have."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from rotorfit.core.frames import AXES, POSE_UNITS
from rotorfit.core.laws import structure_named
from rotorfit.exports.formats import Language
from rotorfit.exports.subject import Subject

SPEEDS = {"x": "forward", "y": "left", "z": "v_z", "yaw": "v_yaw"}
"""Axis to the variable that holds its velocity in the heading frame."""


@dataclass(frozen=True)
class Equation:
    """The motion of one axis.

    Attributes:
        axis: Name of the axis.
        demand: Acceleration demanded by the command, an expression in u_x, u_y, u_z, u_yaw.
        acceleration: v', an expression in the velocities, the demand w_AXIS, the trim c_AXIS and q_AXIS.
        lagged: q', if the law has a lag; otherwise empty.
        settled: q after a long constant command, if the law has a lag; otherwise empty.
    """

    axis: str
    demand: str
    acceleration: str
    lagged: str = ""
    settled: str = ""


@dataclass(frozen=True)
class Constant:
    """A number with its name, such as `INPUT_X`, and its meaning."""

    name: str
    value: float
    text: str


def number(value: float) -> str:
    """A number with 12 digits (relative error at most 5e-13) and a decimal point: YAML 1.1 reads 1e-05 as a string."""
    text = format(value, ".12g")
    mantissa, exponent, power = text.partition("e")
    return f"{mantissa if '.' in mantissa else f'{mantissa}.0'}{exponent}{power}"


def constants(subject: Subject) -> Iterator[Constant]:
    """The numbers of every exported law, axis by axis, without the delays."""
    for axis in subject.axes:
        point, speed = subject.point(axis), f"{POSE_UNITS[axis]}/s"
        unit = subject.commands[AXES.index(axis)].unit
        per = "command of 1" if unit in ("fraction", "unit of command") else unit
        units = {"speed": speed, "acceleration": f"{speed}^2", "gain": f"{speed}^2 per {per}", "command": unit}
        yield Constant(f"INPUT_{axis.upper()}", point.input, f"{speed}^2 per {per}")
        yield Constant(f"DAMPING_{axis.upper()}", point.damping, "1/s")
        for extra in subject.structure(axis).extras:
            text = units.get(extra.unit, extra.unit or "-")
            yield Constant(f"{extra.name.upper()}_{axis.upper()}", point.extra[extra.name], text)


def equations(subject: Subject, language: Language) -> tuple[Equation, ...]:
    """The motion of all four axes; those that are left out keep their velocity.

    Source: the laws of `core.laws`.
    """
    return tuple(_equation(subject, axis, language) for axis in AXES)


def _equation(subject: Subject, axis: str, language: Language) -> Equation:
    if axis not in subject.axes:
        return Equation(axis, language.zero, language.zero)
    structure, v, end = structure_named(subject.model.axes[axis].structure), SPEEDS[axis], f"_{axis.upper()}"
    names = {extra.name for extra in structure.extras}

    def c(name: str) -> str:
        return f"{language.prefix}{name.upper()}{end}"

    w, q, trim = f"w_{axis}", f"q_{axis}", f"c_{axis}"
    damping, one = f"{c('damping')} * {v}", 1.0 if language.zero == "0.0" else 1
    if "drag_share" in names:
        share, speed = c("drag_share"), f"{language.absolute}({v}) / {c('reference_speed')}"
        damping = f"{c('damping')} * ({one} - {share} + {share} * {speed}) * {v}"
    if "cross_damping" in names:
        damping += f" - {c('cross_damping')} * {SPEEDS[{'x': 'y', 'y': 'x'}[axis]]}"
    demand = f"{c('input')} * {_answered(axis, names, c, language)}"
    if "cross_input" in names:
        demand += f" + {c('cross_input')} * u_{ {'x': 'y', 'y': 'x'}[axis] }"
    if "zero" in names:
        lead = f"{c('zero')} / {c('lag')}"
        lagged = f"(({one} - {lead}) * {w} + {trim} - {damping} - {q}) / {c('lag')}"
        return Equation(axis, demand, f"{q} + {lead} * {w}", lagged, f"({one} - {lead}) * {w} - {damping}")
    if structure.order == 2:
        asked = f"{w} - {damping}"
        if structure.limited:
            asked = f"({asked}) / {language.larger}({one}, {_beyond(subject, axis, language)})"
        return Equation(axis, demand, q, f"({asked} + {trim} - {q}) / {c('lag')}", asked)
    if structure.order == 1:
        lagged = f"({w} - {q}) / {c('lag')}" + _turning(subject, axis)
        return Equation(axis, demand, f"{q} - {damping} + {trim}", lagged, w)
    return Equation(axis, demand, f"{w} - {damping} + {trim}")


def _beyond(subject: Subject, axis: str, language: Language) -> str:
    """What is asked for over the limit; x and y, where both have one, have it together."""
    pair = (
        [k for k in ("x", "y") if k in subject.axes and subject.structure(k).limited] if axis in ("x", "y") else [axis]
    )
    parts = []
    for k in pair:
        end = f"_{k.upper()}"
        asked = f"(w_{k} - {language.prefix}DAMPING{end} * {SPEEDS[k]}) / {language.prefix}ACCELERATION_LIMIT{end}"
        parts.append(f"({asked}) * ({asked})")
    return f"{language.root}({' + '.join(parts)})"


def _turning(subject: Subject, axis: str) -> str:
    """What a turn adds to q' where the lagged demand of x and y keeps its direction in the world."""
    if axis not in ("x", "y") or {"x", "y"} - {*subject.axes}:
        return ""
    pair = {"x": "y", "y": "x"}
    if not any(subject.structure(k).world for k in pair) or any(subject.structure(k).order > 1 for k in pair):
        return ""
    lagged = "q" if subject.structure(pair[axis]).order else "w"
    return f" {'+' if axis == 'x' else '-'} {SPEEDS['yaw']} * {lagged}_{pair[axis]}"


def _answered(axis: str, names: set[str], c: Callable[[str], str], language: Language) -> str:
    """The effective command: all of it, with another gain upwards, limited to a level, or without a dead zone."""
    u = f"u_{axis}"
    if "asymmetry" in names:
        return f"({u} + {c('asymmetry')} * {language.absolute}({u}))"
    if "level" in names:
        return f"{language.smaller}({language.larger}({u}, -{c('level')}), {c('level')})"
    if "dead_zone" in names:
        above, below = (f"{language.larger}({sign}{u} - {c('dead_zone')}, {language.zero})" for sign in ("", "-"))
        return f"({above} - {below})"
    return u
