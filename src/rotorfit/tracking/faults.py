"""Faults of the data of a flight while it is tracked, from one jump of the heading to the next.

Before and after a jump commands act in other directions, so each regime's model has the faults of its own time.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.finding import MISREAD, WRONG_FRAME, Finding, by_gravity
from rotorfit.core.flight_data import Flight
from rotorfit.core.frozen import with_frozen
from rotorfit.core.model import Model, with_findings
from rotorfit.diagnosis.doctor import faults_of
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.tracking.excited_time import LONGEST
from rotorfit.tracking.groups import part_between
from rotorfit.tracking.regimes import Bounds

CHECKED = 11.0
"""Flight time from which on faults of the frame are told [s]. Of 46 flights, 26 of them recorded, 4 told one that was
none after 5 or 8 s, none from 11 s on."""


def turns_of(bounds: Bounds) -> tuple[float, ...]:
    """The times at which the heading jumped [s], in order."""
    return tuple(when for when, alarm in bounds if alarm and alarm.turned)


def last_turn(turns: Sequence[float], time: float) -> float:
    """The last jump of the heading up to a time [s]; -inf if there was none."""
    return max((turn for turn in turns if turn <= time), default=-np.inf)


def faults_after(flight: Flight, turns: Sequence[float], begin: float) -> tuple[Finding, ...]:
    """The faults of the data from a jump of the heading, or -inf, to the next [s]."""
    part = _until_next(flight, turns, begin)
    return faults_of(part) if part and part.duration >= LEAST_TIME else ()


def checked(flight: Flight, turns: Sequence[float], now: float) -> tuple[Finding, ...] | None:
    """What is wrong with the frame of the data since the heading last jumped; None before that can be told."""
    part = _until_next(flight, turns, max(last_turn(turns, now), now - LONGEST))
    if part is None or part.duration < CHECKED:
        return None
    return tuple(one for one in faults_of(part) if one.code in MISREAD)


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
    known = [one for one in flight.findings if not (turns and one.code in WRONG_FRAME)]
    codes = {(one.code, one.axis) for one in known}
    if turns or not known:
        known += [
            replace(one, evidence=f"{flight.path}: {one.evidence}")
            for one in faults
            if (one.code, one.axis) not in codes
        ]
    return with_frozen(with_findings(model, (*by_gravity(known), *model.findings)))
