"""From a subject to the text of a file, by a template."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from importlib import resources
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from rotorfit.core.errors import ExportError
from rotorfit.core.frames import AXES
from rotorfit.core.laws import FIRST_ORDER_DELAY
from rotorfit.core.limits import CommandMeaning
from rotorfit.core.model import COEFFICIENTS, Model, Predictor
from rotorfit.core.plain import listed
from rotorfit.dynamics.trajectory import state_space
from rotorfit.dynamics.transfer_function import has_transfer_function
from rotorfit.exports.equations import SPEEDS, Equation, constants, equations, number
from rotorfit.exports.formats import NUMPY, Format, Language
from rotorfit.exports.subject import Subject, unknown_of

if TYPE_CHECKING:
    from jinja2 import Environment

_PLAIN = (FIRST_ORDER_DELAY.name, "first_order")


def summary_of(subject: Subject, form: Format) -> str:
    """The contents of a file of the format, in a sentence or two."""
    steps = (
        f" Between changes of the command the motion is stepped by Runge-Kutta of order 4, at most "
        f"{subject.longest:.3g} s at a time."
    )
    return form.summary + (steps if form.language else "")


def check(subject: Subject, to: str, form: Format) -> None:
    """Refuses a structure that a format cannot hold, and a model without an axis that it requires.

    Raises:
        ExportError: The message has the axes, and what to try.
    """
    bent = [axis for axis in subject.axes if not subject.structure(axis).linear]
    other = [axis for axis in subject.axes if subject.structure(axis).name not in _PLAIN]
    wrong = bent if form.linear else other if form.plain else []
    if wrong:
        laws = ", ".join(f"{axis} {subject.structure(axis).name}" for axis in wrong)
        kind = "linear laws" if form.linear else "the first-order law with a delay"
        raise ExportError(
            f"{to} holds {kind} only, and the model has {laws}; export --to casadi, numpy, jax, matlab or c, or fit "
            f"with --structure {FIRST_ORDER_DELAY.name}"
        )
    unsteady = [axis for axis in AXES if steady_gain(subject, axis) is None]
    if form.steady and unsteady:
        axes = subject.original.axes
        untold = {axis: listed(unknown_of(axes[axis])) for axis in unsteady if axes[axis].predictor}
        untold = {axis: names for axis, names in untold.items() if names and axis not in subject.axes}
        still = [axis for axis in unsteady if axis not in untold]
        verbs, them = ("is left out or has", "it") if len(still) == 1 else ("are left out or have", "them")
        why = [f"the model does not know the {names} of {axis}" for axis, names in untold.items()]
        why += [f"{listed(still)} {verbs} no positive damping"] * bool(still)
        cure = [f"fit a flight that moves {them}"] * bool(still) + ["try --predictor"] * bool(untold)
        raise ExportError(
            f"{to} holds a velocity on all four axes, and {' and '.join(why)}; {', '.join(cure)}, or export to another "
            "format"
        )


def render(subject: Subject, to: str, form: Format, header: Sequence[str]) -> str:
    """The text of the whole file.

    Args:
        subject: What is exported.
        to: Name of the format.
        form: The format.
        header: Lines of its header.
    """
    return (
        _environment()
        .get_template(form.template)
        .render(**_context(subject, to, form.language or NUMPY), header=header)
    )


@cache
def _environment() -> "Environment":
    """The templates, each compiled once."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_template), undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        keep_trailing_newline=True, line_comment_prefix="##",
    )  # fmt: skip
    environment.filters["number"] = number
    return environment


def _template(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath("templates", name).read_text(encoding="utf-8")


def _context(subject: Subject, to: str, language: Language) -> dict[str, Any]:
    """The values for the templates."""
    language = replace(language, prefix=language.prefix.format(NAME=subject.name.upper()))
    laws = {equation.axis: equation for equation in equations(subject, language)}
    limits = [command.limit if axis in subject.axes else None for axis, command in _commands(subject)]
    parts, steady = segments(subject, subject.dt), {axis: steady_gain(subject, axis) for axis in AXES}
    bounds = [abs(steady[axis] or 0.0) * (limit or 0.0) for axis, limit in zip(AXES, limits, strict=True)]
    units = {constant.name: constant.text for constant in constants(subject)}
    return {
        "to": to,
        "subject": subject,
        "name": subject.name,
        "NAME": subject.name.upper(),
        "AXES": AXES,
        "delays": [subject.point(axis).delay for axis in AXES],
        "limits": limits,
        "constants": tuple(constants(subject)),
        "units": {axis: units[f"INPUT_{axis.upper()}"] for axis in subject.axes},
        "extra_units": {
            axis: {
                extra.name: units[f"{extra.name.upper()}_{axis.upper()}"] for extra in subject.structure(axis).extras
            }
            for axis in subject.axes
        },
        "intervals": {axis: _of_exported(subject, axis) for axis in subject.axes},
        "equations": laws,
        "used": [axis for axis in AXES if mentioned(f"u_{axis}", [law.demand for law in laws.values()])],
        "turned": [
            v for v in ("forward", "left") if mentioned(v, [f"{x.acceleration} {x.lagged}" for x in laws.values()])
        ],
        "settling": [v for v in (*SPEEDS.values(), *(f"u_{axis}" for axis in AXES)) if mentioned(v, _settling(laws))],
        "lagged": subject.lagged,
        "longest": subject.longest,
        "space": _space(subject) if subject.linear else None,
        "states": [f'"{sign}{axis}"' for sign in ("", "v_") for axis in subject.axes]
        + [f'"q_{axis}"' for axis in subject.lagged],
        "parts": parts,
        "memory": max(age for _, ages in parts for age in ages),
        "steady": steady,
        "bounds": bounds if all(bounds) else None,
        "fastest": max(abs(subject.point(axis).damping) for axis in subject.axes),
        "K": paper_coefficients(subject),
    }


def intervals(subject: Subject, axis: str) -> dict[str, tuple[float, float]]:
    """The closed 95 % intervals of the coefficients that the law of an axis has."""
    names = (*COEFFICIENTS, *(extra.name for extra in subject.structure(axis).extras))
    known = subject.original.axes[axis].ci95
    ends = ((name, *known.get(name, (None, None))) for name in names)
    return {name: (low, high) for name, low, high in ends if low is not None and high is not None}


def _of_exported(subject: Subject, axis: str) -> dict[str, tuple[float, float]]:
    """The intervals of the coefficients that are exported as they were estimated, neither scaled nor rounded."""
    point, estimate = subject.point(axis), subject.original.axes[axis].predictor

    def value(predictor: Predictor, name: str) -> float:
        return getattr(predictor, name) if name in COEFFICIENTS else predictor.extra[name]

    known = intervals(subject, axis)
    return {name: ends for name, ends in known.items() if estimate and value(point, name) == value(estimate, name)}


def mentioned(variable: str, expressions: Sequence[str]) -> bool:
    """Whether a variable occurs in one of the expressions."""
    return any(re.search(rf"\b{variable}\b", expression) for expression in expressions)


def _settling(laws: Mapping[str, Equation]) -> list[str]:
    """The expressions from which the initial states of lags are computed."""
    return [f"{law.demand} {law.settled}" for law in laws.values() if law.settled]


def _space(subject: Subject) -> dict[str, Any]:
    """The state space at heading 0, as lists."""
    space = state_space(subject.model)
    return {"axes": space.axes, "A": space.A.tolist(), "B": space.B.tolist(), "C": space.C.tolist()}


def _commands(subject: Subject) -> list[tuple[str, CommandMeaning]]:
    return list(zip(AXES, subject.commands, strict=True))


def steady_gain(subject: Subject, axis: str) -> float | None:
    """Steady speed per command [m/s or rad/s]; None if the axis is left out, or its law has no constant steady gain."""
    point = subject.point(axis)
    if axis not in subject.axes or not has_transfer_function(subject.structure(axis)) or point.damping <= 0:
        return None
    return point.input / point.damping


def segments(subject: Subject, dt: float) -> list[tuple[float, tuple[int, ...]]]:
    """Parts of a sample period between changes of a delayed command: duration, and age of the command on each axis.

    Args:
        subject: The subject, with the delays.
        dt: Sample period [s].

    Returns:
        Durations [s] that sum to dt, and ages in samples, 0 for the command that is sent at the start of the period.
    """
    delays = [subject.point(axis).delay for axis in AXES]
    whole = [int(delay / dt + 1e-9) for delay in delays]
    rest = [max(delay - n * dt, 0.0) for delay, n in zip(delays, whole, strict=True)]
    rest = [r if r > 1e-9 * dt else 0.0 for r in rest]
    cuts = sorted({0.0, dt, *rest})
    return [
        (end - start, tuple(n + (start < r) for n, r in zip(whole, rest, strict=True))) for start, end in pairwise(cuts)
    ]


def paper_coefficients(subject: Subject) -> list[float] | None:
    """The eight coefficients of the paper's model, g and b of x, y, z, yaw in turn; None if they are not all available.

    Source: paper, eqs. (4) and (6); `K` of jrsbenevides/drone_dev, config/bebopParameters.yaml, in the same order.
    """
    if len(subject.axes) < len(AXES) or subject.physical or not all(_is_plain(subject.model, axis) for axis in AXES):
        return None
    return [value for axis in AXES for value in (subject.point(axis).input, subject.point(axis).damping)]


def _is_plain(model: Model, axis: str) -> bool:
    return model.axes[axis].structure in _PLAIN
