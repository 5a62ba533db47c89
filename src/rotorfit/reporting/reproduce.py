"""How to reproduce a report: command lines, versions, hashes of the logs, the card in full."""

import json
import platform
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Any

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import STRUCTURE, Model
from rotorfit.dynamics.other_limits import flown_card
from rotorfit.estimation.methods import maximises_likelihood
from rotorfit.version import __version__


@dataclass(frozen=True)
class LogUsed:
    """A log, its role, its hash, and its common window [s]."""

    path: str
    role: str
    sha256: str
    span: tuple[float, float]


@dataclass(frozen=True)
class Recipe:
    """Everything that is needed to reproduce the numbers.

    Attributes:
        commands: Lines for a shell.
        versions: Program to version.
        logs: The logs that were read.
        card: The card as TOML.
    """

    commands: tuple[str, ...]
    versions: tuple[tuple[str, str], ...]
    logs: tuple[LogUsed, ...]
    card: str


def recipe_of(model: Model, flights: Sequence[Flight]) -> Recipe:
    """The recipe of a model and its report.

    Args:
        model: The model, with the flights that it was fitted to.
        flights: The validation flights.
    """
    training = _training(model)
    tested = [LogUsed(f.path, "validation", f.sha256, f.span) for f in flights]
    fit = fit_words(model, structure_asked(model), axes_asked(model))
    fit += ["--leave-one-out"] * (model.leave_one_out is not None) + ["--uncertainty"] * (model.uncertainty is not None)
    commands = [shlex.join([*fit, "-o", "fitted.json" if model.conversion else "model.json"]), *_converting(model)]
    if tested:
        commands += [shlex.join(["rotorfit", "validate", "model.json", *map(_log, tested)])]
        commands += [shlex.join(["rotorfit", "report", "model.json", *map(_log, tested), "-o", "report.html"])]
    names = ("numpy", "scipy", "numba")
    versions = (("rotorfit that fitted", model.rotorfit), ("rotorfit that wrote this page", __version__))
    used = tuple((name, metadata.version(name)) for name in names)
    return Recipe(
        tuple(commands),
        (*versions, ("Python", platform.python_version()), *used),
        (*training, *tested),
        card_text(flown_card(model).raw),
    )


def _converting(model: Model) -> list[str]:
    """The command line that converts the model to its limits, if these are not those of its flights."""
    if not model.conversion:
        return []
    now, flown = model.card.raw["limits"], model.conversion.limits
    changed = (f"{name}={value:.15g}" for name, value in model.card.limits.items() if now[name] != flown[name])
    limits = ",".join(changed)
    return [shlex.join(["rotorfit", "convert", "fitted.json", "--limits", limits, "-o", "model.json"])]


def fit_words(model: Model, structure: str, axes: Sequence[str]) -> list[str]:
    """The words of a fit to the model's flights, with its card, method and prior; without `-o`.

    Args:
        model: The model.
        structure: Law of every axis, or `auto`; empty for the default.
        axes: The axes to fit.
    """
    words = ["rotorfit", "fit", *map(_log, _training(model)), "--card", "card.toml", "--method", model.method]
    words += ["--structure", structure] if structure else []
    words += ["--axes", ",".join(axes)] if len(axes) < len(AXES) else []
    return words + ["--prior"] * (model.prior is not None)


def _training(model: Model) -> list[LogUsed]:
    return [LogUsed(f.path, "training", f.sha256, f.span) for f in model.flights]


def structure_asked(model: Model) -> str:
    """The law that the fit was asked for, or `auto`; empty for the default."""
    known = [axis for axis in model.axes.values() if axis.predictor]
    if not maximises_likelihood(model.method) or not known or any(axis.laws for axis in known):
        return ""
    if any(candidate.chosen for axis in known for candidate in axis.candidates):
        return "auto"
    return next((axis.structure for axis in known if axis.structure != STRUCTURE), STRUCTURE)


def axes_asked(model: Model) -> tuple[str, ...]:
    """The axes that the fit was asked for: all but those that it left out though the flights command them."""
    served = {axis for flight in model.flights for axis in flight.axes}
    left_out = ["not_fitted"]
    if maximises_likelihood(model.method):  # its earlier files say so of both
        left_out.append("not_excited")
    asked = [a for a in AXES if a not in served or model.axes[a].noise or model.axes[a].status["input"] not in left_out]
    return tuple(asked) or AXES


def _log(log: LogUsed) -> str:
    """The log with its span, as the command line takes it."""
    return f"{log.path}@{log.span[0]:.15g}:{log.span[1]:.15g}"


def card_text(raw: Mapping[str, Any]) -> str:
    """A card as TOML.

    Args:
        raw: The parsed card: values, sections, and inline tables in sections.
    """
    plain = [f"{_key(key)} = {_value(value)}" for key, value in raw.items() if not isinstance(value, Mapping)]
    sections = [
        "\n".join(["", f"[{_key(key)}]", *(f"{_key(name)} = {_value(value)}" for name, value in section.items())])
        for key, section in raw.items()
        if isinstance(section, Mapping)
    ]
    return "\n".join([*plain, *sections]).strip() + "\n"


def _key(name: str) -> str:
    return (
        name if name.replace("_", "").replace("-", "").isascii() and name.replace("_", "").isalnum() else _value(name)
    )


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(name)} = {_value(part)}" for name, part in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(part) for part in value) + "]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
