"""Faults of the data of a flight while it is tracked, from one jump of the heading to the next.

Before and after a jump commands act in other directions, so each regime's model has the faults of its own time.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.finding import MISREAD, Finding, by_gravity
from rotorfit.core.flight_data import Flight
from rotorfit.core.frozen import with_frozen
from rotorfit.core.model import Model, with_findings
from rotorfit.diagnosis.doctor import faults_of
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.tracking.excited_time import excited_time
from rotorfit.tracking.groups import looks_back, part_between
from rotorfit.tracking.regimes import Bounds

CHECKED = 11.0
"""Time under commands of x or y from which on faults of the frame are told [s]. Of 46 flights, 26 of them recorded, 4
told one that was none after 5 or 8 s, none from 11 s on."""

OF_LENGTH = "short_data"
"""The finding that a flight is short: the time between two jumps of the heading is not the flight."""


def turns_of(bounds: Bounds) -> tuple[float, ...]:
    """The times at which the heading jumped [s], in order."""
    return tuple(when for when, alarm in bounds if alarm and alarm.turned)


def last_turn(turns: Sequence[float], time: float) -> float:
    """The last jump of the heading up to a time [s]; -inf if there was none."""
    return max((turn for turn in turns if turn <= time), default=-np.inf)


def faults_after(flight: Flight, turns: Sequence[float], begin: float) -> tuple[Finding, ...]:
    """The faults of the data from a jump of the heading, or -inf, to the next [s].

    Those of the frame are among them where the part is long enough to tell them.
    """
    part = _until_next(flight, turns, begin)
    if part is None or part.duration < LEAST_TIME:
        return ()
    hidden = (*(() if _tells_frame(part) else MISREAD), *((OF_LENGTH,) if turns else ()))
    return tuple(one for one in faults_of(part) if one.code not in hidden)


def checked(flight: Flight, turns: Sequence[float], now: float) -> tuple[Finding, ...] | None:
    """What is wrong with the frame of the data since the heading last jumped; None before that can be told.

    The data are those that the estimates of x and y look back over.
    """
    since = max(last_turn(turns, now), 0.0)
    part = _until_next(flight, turns, min(looks_back(flight, (axis,), since, now) for axis in ("x", "y")))
    if part is None or not _tells_frame(part):
        return None
    return tuple(one for one in faults_of(part) if one.code in MISREAD)


def _tells_frame(part: Flight) -> bool:
    """Whether commands of x and y are long enough to tell a wrong frame; the whole time where there are none."""
    commands = part.command[:, :2]
    if not np.any(np.diff(commands, axis=0)):
        return part.duration >= CHECKED
    return excited_time(part.command_time, commands, *part.span) >= CHECKED


def _until_next(flight: Flight, turns: Sequence[float], begin: float) -> Flight | None:
    """The part of a flight from a time to the next jump of the heading [s]."""
    end = min((turn for turn in turns if turn > begin), default=np.inf)
    return part_between(flight, begin, float(np.nextafter(end, -np.inf)))


def with_faults(model: Model | None, flight: Flight, turns: Sequence[float], faults: Sequence[Finding]) -> Model | None:
    """A model with the faults of its data: those of its log, if that was diagnosed, or of what was heard.

    Args:
        model: Of a regime; None if it has none.
        flight: The flight, whose own findings are those of its log.
        turns: When the heading jumped [s]: what the log tells of the frame then holds of neither part.
        faults: Those of the time of the regime.
    """
    if model is None:
        return None
    known = [one for one in flight.findings if not (turns and one.code in MISREAD)]
    codes = {(one.code, one.axis) for one in known}
    if turns or not known:
        known += [
            replace(one, evidence=f"{flight.path}: {one.evidence}")
            for one in faults
            if (one.code, one.axis) not in codes
        ]
    return with_frozen(with_findings(model, (*by_gravity(known), *model.findings)))
