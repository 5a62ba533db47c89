"""Subject: the input of an export. The model with the exported axes only, and the meaning of each command."""

import re
from dataclasses import dataclass, replace

from rotorfit.assessment.summary import is_told
from rotorfit.core.errors import ExportError
from rotorfit.core.flight_data import ANSWER
from rotorfit.core.frames import AXES
from rotorfit.core.laws import Structure, structure_named
from rotorfit.core.limits import COMMAND_UNITS, CommandMeaning, command_of, meaning_of
from rotorfit.core.model import FROZEN, MEND, PLANNED, Axis, Model, Predictor
from rotorfit.core.plain import by_reason, listed
from rotorfit.dynamics.other_limits import check_cross_inputs, scaled

SUBSTEP = 0.1
"""Longest Runge-Kutta step over the shortest time constant: relative error 1e-6 or less."""

SLOWEST_RATE = 2.0
"""Least rate for which the Runge-Kutta step is chosen, so that turns at this rate are resolved too [rad/s]."""

LONGEST_NAME = 40
"""Largest length of a name: MATLAB truncates the names that are made from it at 63 characters."""

_WORDS = """
    break case catch classdef continue do else elseif end endfor endfunction endif endswitch endwhile for function
    global if otherwise parfor persistent return spmd switch try until unwind_protect while
"""

_FUNCTIONS = "ans derivative flow memory parameters segments simulate start step"

_CALLED = "ceil cos diff eye floor max numel repmat sin sum unique zeros"

TAKEN = frozenset(f"{_WORDS} {_FUNCTIONS} {_CALLED}".split())
"""Reserved words of MATLAB and Octave, the functions of our file for them, beside which the name stands alone, and
those that it calls, which a file of the same name would hide; elsewhere it gets a prefix or suffix."""


@dataclass(frozen=True)
class Subject:
    """The contents of an export, whatever its format.

    Attributes:
        name: Name of the vehicle in the generated code, an identifier.
        model: The model whose simulation the export reproduces: axes that are left out have no predictor and keep their
            velocity; gains are per command of the export; delays are at least 0, and rounded if requested.
        original: The model as given: coefficients with intervals.
        scored: `model` with the gains per command of the card: what predicts its flights.
        commands: Meaning of the command of each axis.
        physical: Whether commands are in SI units where the card has fractions.
        dt: Sample period of the C header and of rounded delays [s].
        notes: Sentences about what was left out, rounded or scaled.
        origin: Name of the model file, or `a model in memory`.
        sha256: Hex digest of the model file.
    """

    name: str
    model: Model
    original: Model
    scored: Model
    commands: tuple[CommandMeaning, ...]
    physical: bool
    dt: float
    notes: tuple[str, ...]
    origin: str
    sha256: str

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes that the export has numbers for."""
        return tuple(axis for axis in AXES if self.model.axes[axis].predictor)

    @property
    def changed(self) -> tuple[str, ...]:
        """The axes that move otherwise than by the model as given, because of another delay."""
        return tuple(
            axis for axis in self.axes if self.scored.axes[axis].predictor != self.original.axes[axis].predictor
        )

    @property
    def lagged(self) -> tuple[str, ...]:
        """The axes whose law has a state besides position and velocity."""
        return tuple(axis for axis in self.axes if self.structure(axis).order)

    @property
    def linear(self) -> bool:
        """Whether every law is linear, so that there is a state space at a fixed heading."""
        return all(self.structure(axis).linear for axis in self.axes)

    @property
    def longest(self) -> float:
        """Longest Runge-Kutta step [s]."""
        longest = SUBSTEP / max(SLOWEST_RATE, *(_rate(self.structure(axis), self.point(axis)) for axis in self.axes))
        return float(f"{longest:.2g}")

    def structure(self, axis: str) -> Structure:
        """The law of an axis."""
        return structure_named(self.model.axes[axis].structure)

    def point(self, axis: str) -> Predictor:
        """The parameters of an axis; zeros if it is left out."""
        return self.model.axes[axis].predictor or Predictor(0.0, 0.0, 0.0)


def _rate(structure: Structure, point: Predictor) -> float:
    """Fastest rate of an axis [1/s]; for quadratic drag, at twice the speed that was flown."""
    rate = abs(point.damping) + abs(point.extra.get("cross_damping", 0.0))
    rate *= 1 + 3 * point.extra.get("drag_share", 0.0)
    return rate + (1 / point.extra["lag"] if structure.order else 0.0)


def subject_of(
    model: Model, name: str, origin: str, sha256: str, *, dt: float, predictor: bool, physical: bool, round_delay: bool
) -> Subject:
    """The subject of an export.

    Args:
        model: The model.
        name: Any text; it is made an identifier.
        origin: Where the model is from.
        sha256: Hash of its file.
        dt: Sample period [s].
        predictor: Whether axes that are not identifiable are exported at the likelihood's point.
        physical: Whether commands are in SI units where the card has fractions of a limit.
        round_delay: Whether delays are rounded to whole samples.

    Raises:
        ExportError: No axis is left, the sample period is not valid, or the card lacks what physical commands need.
    """
    if not 1e-4 <= dt <= 10:
        raise ExportError(
            f"a sample period of {dt:g} s cannot be used; give seconds between 0.0001 and 10, such as 0.02"
        )
    kept, notes = _kept(model, predictor)
    kept, said = _causal(kept)
    notes = [*notes, *said]
    if round_delay:
        kept, said = _rounded(kept, dt)
        notes = [*notes, *said]
    scored = kept
    if physical:
        kept, said = _physical(kept)
        notes = [*notes, *said]
    commands = tuple(command_of(kept.card, axis, physical) for axis in AXES)
    return Subject(identifier(name), kept, model, scored, commands, physical, dt, tuple(notes), origin, sha256)


def identifier(text: str) -> str:
    """A text as an identifier of C, Python and MATLAB: lower-case letters, digits and underscores, a letter first."""
    plain = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:LONGEST_NAME].rstrip("_")
    return plain if plain[:1].isalpha() and plain not in TAKEN else f"model_{plain}".rstrip("_")


def unknown_of(axis: Axis) -> list[str]:
    """The coefficients of an axis that are not identifiable, as `delay (not_identifiable)`; empty if all are.

    A lag determined by its prior counts as known: the data determine the part of it that matters, delay plus lag. So
    does a zero that may be none, if it is bounded above.
    """
    structure, believed = structure_named(axis.structure), {"lag"} if axis.lag_prior is not None else set()
    if axis.status.get("zero") == "not_identifiable" and axis.ci95["zero"][1] is not None:
        believed.add("zero")
    known = {"input": axis.input, "damping": axis.damping, **({"delay": axis.delay} if structure.delayed else {})}
    known |= {extra.name: axis.extra.get(extra.name) for extra in structure.extras if extra.name not in believed}
    return [f"{name} ({axis.status.get(name, 'unknown')})" for name, value in known.items() if value is None]


BACKWARDS = {"x": "backwards", "y": "to the right", "z": "down", "yaw": "clockwise"}
"""Where an axis moves in its negative direction."""


def _kept(model: Model, predictor: bool) -> tuple[Model, list[str]]:
    """The model without the axes that are left out, and a sentence on each of those."""
    axes, notes, missing = dict(model.axes), [], dict[str, str]()
    for name, axis in model.axes.items():
        unknown = unknown_of(axis)
        if axis.predictor is None:
            missing[name] = f"the model has no numbers for it ({axis.status['input']})"
        elif unknown and predictor:
            notes.append(
                f"{name} is exported by the point that predicts best, as was asked: the data "
                f"{'deny the law of' if axis.status['input'] == 'refuted' else 'cannot tell'} {listed(unknown)}, so "
                "single coefficients may be far off."
            )
        elif unknown:
            axes[name] = replace(axis, predictor=None)
            missing[name] = f"the data cannot tell {listed(unknown)}"
        if name in missing:
            more = f"{_told(axis)}; the option predictor exports the point that predicts best" if axis.predictor else ""
            notes.append(f"{name} is left out and keeps its velocity: {missing[name]}{more}.")
    for one, other in (("x", "y"), ("y", "x")):
        if axes[one].predictor and not axes[other].predictor and structure_named(axes[one].structure).coupled:
            axes[one] = replace(axes[one], predictor=None)
            missing[one] = f"its law is coupled with that of {other}"
            notes.append(f"{one} is left out, too: {missing[one]}.")
    if not any(axis.predictor for axis in axes.values()):
        raise ExportError(f"nothing to export: {by_reason(missing)}; {_remedy(model)}")
    errors = {(one.code, one.axis): None for one in model.findings if one.severity == "error"}
    notes += [
        f"The finding {code} is an error: do not use {axis or 'any axis'} before it is cured."
        for code, axis in errors
        if axis is None or axes[axis].predictor
    ]
    if any(finding.code == "clock_includes_delay" for finding in model.findings):
        notes.append(
            f"The delays are not the vehicle's: two clocks recorded it, and commands were placed about {ANSWER:g} s "
            "before their answers. Put the vehicle's delay in their place."
        )
    notes += [
        f"The input of {name} is negative: a positive command moves the vehicle {backwards}. Where the card should "
        f"turn {name} of [command], correct it and fit again."
        for name, backwards in BACKWARDS.items()
        if (known := axes[name].predictor) and known.input < 0
    ]
    return replace(model, axes=axes), notes


def _told(axis: Axis) -> str:
    """Which combinations the data tell of an axis whose coefficients they do not."""
    parts = axis.combinations
    names = [name for name in ("steady_gain", "total_lag") if name in parts and is_told(name, parts[name])]
    return f", but {listed([name.replace('_', ' ') for name in names])}" if names else ""


def _remedy(model: Model) -> str:
    """What to do where no axis can be exported."""
    if any(axis.predictor for axis in model.axes.values()):
        return "--predictor exports the point that predicts best"
    frozen = any(axis.status["input"] == FROZEN for axis in model.axes.values())
    return MEND if frozen else f"fit a flight that moves an axis{PLANNED}"


def size_of(subject: Subject, axis: str) -> float:
    """What a command of 1 of the card is in the export's commands."""
    meaning = meaning_of(subject.model.card, axis)
    return meaning.setting if subject.physical and meaning.limit and meaning.setting else 1.0


def _physical(model: Model) -> tuple[Model, list[str]]:
    """The model with commands in SI units: gains divided by the limit that a command of 1 stands for."""
    axes, notes, factors = dict(model.axes), [], dict.fromkeys(AXES, 1.0)
    for name, axis in model.axes.items():
        if axis.predictor is None:
            continue
        meaning = meaning_of(model.card, name)
        if meaning.asked is None or (meaning.limit and meaning.setting is None):
            why = meaning.reason or f"the card does not say what its limit of {meaning.limit} was"
            raise ExportError(
                f"physical commands: {why}; add it to the card and fit again, or export without --physical"
            )
        if meaning.limit and meaning.setting:
            factors[name] = 1 / meaning.setting
            axes[name] = replace(axis, predictor=scaled(axis.predictor, factors[name]))
            notes.append(
                f"The command of {name} is physical: what the vehicle takes is this divided by {meaning.setting:.10g} "
                f"{COMMAND_UNITS[meaning.asked]}, its limit by the card of the model."
            )
    check_cross_inputs(model, factors)
    return replace(model, axes=axes), notes


def _causal(model: Model) -> tuple[Model, list[str]]:
    """The model with delays of at least 0, and a note for each that was negative."""
    axes, notes = dict(model.axes), []
    for name, axis in model.axes.items():
        if axis.predictor is None or axis.predictor.delay >= 0:
            continue
        axes[name] = replace(axis, predictor=replace(axis.predictor, delay=0.0))
        notes.append(
            f"The delay of {name} is negative in the model, {axis.predictor.delay:.4f} s, and 0 here: no command acts "
            "before it is sent."
        )
    return replace(model, axes=axes), notes


def _rounded(model: Model, dt: float) -> tuple[Model, list[str]]:
    axes, notes = dict(model.axes), []
    for name, axis in model.axes.items():
        if axis.predictor is None:
            continue
        delay = dt * round(axis.predictor.delay / dt)
        axes[name] = replace(axis, predictor=replace(axis.predictor, delay=delay))
        off = 1e3 * (delay - axis.predictor.delay)
        notes.append(
            f"The delay of {name} is rounded to whole samples of {dt:g} s, as was asked: {axis.predictor.delay:.4f} s "
            f"to {delay:g} s, {abs(off):.1f} ms {'longer' if off > 0 else 'shorter'}."
        )
    return replace(model, axes=axes), notes
