"""Case: a model with the evidence for and against it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rotorfit.assessment.paired import paired_test
from rotorfit.core.flight_data import Flight
from rotorfit.core.model import Model
from rotorfit.core.results import PairedTest, Validation


def same_motion(one: Flight, other: Flight) -> bool:
    """Whether two cards read the same poses at the same times, so that errors can be subtracted start by start."""
    pairs = ((one.pose_time, other.pose_time), (one.position, other.position), (one.yaw, other.yaw))
    return all(np.array_equal(a, b) for a, b in pairs)


UNPROVEN = Validation((), {"hold": (), "paper": ()})
"""Validation of a model for which no flight was kept."""


@dataclass(frozen=True)
class Case:
    """A model and its validation.

    Attributes:
        path: Path of the model file.
        model: The model with its findings.
        training: The flights to which it was fitted; empty if not available.
        validation: Its scores; without flights if there are none.
        flights: The flights of the scores, in the same order; empty if not available.
    """

    path: str
    model: Model
    training: tuple[Flight, ...] = ()
    validation: Validation = UNPROVEN
    flights: tuple[Flight, ...] = ()


def paired_cases(cases: Sequence[Case]) -> dict[tuple[int, int], PairedTest]:
    """Tests every model against every later one, where their cards read the same motion from the logs."""
    tests = {}
    for i, j in combinations(range(len(cases)), 2):
        one, other = cases[i], cases[j]
        if not one.flights or not all(map(same_motion, one.flights, other.flights)):
            continue
        scored = zip(one.validation.flights, other.validation.flights, strict=True)
        counted = [() if a.fitted or b.fitted else a.moved for a, b in scored]
        first, second = (case.validation.errors["model"] for case in (one, other))
        tests[i, j] = paired_test((one.path, other.path), first, second, counted)
    return tests
