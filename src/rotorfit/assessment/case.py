"""Case: a model with the evidence for and against it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rotorfit.assessment.paired import paired_scores
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.limits import Meaning, meaning_of
from rotorfit.core.model import Model
from rotorfit.core.plain import listed
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


def reservations(names: Sequence[str], models: Sequence[Model], validations: Sequence[Validation]) -> Iterator[str]:
    """Where models are told different things of the same flights; a line for each, about it and the first model.

    Args:
        names: Names of the models.
        models: The models.
        validations: Their validations on the same flights.
    """
    first, its = models[0], validations[0]
    for name, model, validation in zip(names, models, validations, strict=True):
        if model.conversion:
            yield f"{name} was converted: it is for flights under its new limits"
        shared = [axis for axis in AXES if model.axes[axis].predictor and first.axes[axis].predictor]
        other = [axis for axis in shared if _contradict(meaning_of(model.card, axis), meaning_of(first.card, axis))]
        if other:
            yield (
                f"{name}: by its card a command of 1 on {listed(other)} asks for something else than by that of "
                f"{names[0]}, or under other limits: of one log only one of them is true"
            )
        pairs = zip(validation.flights, its.flights, strict=True)
        if turning := [own.path for own, other_own in pairs if own.unlike(other_own)]:
            predicts, takes = (name, names[0]) if its.flights[0].heading == "measured" else (names[0], name)
            yield (
                f"{name}: x and y are not tested against {names[0]} on {listed(list(dict.fromkeys(turning)))}, where "
                f"the heading turns: {predicts} predicts it, {takes} has no yaw and takes the recorded one"
            )


def _contradict(one: Meaning, other: Meaning) -> bool:
    """Whether two cards cannot both be right about the commands of an axis; one that does not say contradicts none."""
    if one.asked is None or other.asked is None:
        return False
    settings = {one.setting, other.setting} - {None}
    return one.asked != other.asked or one.limit != other.limit or len(settings) > 1


def paired_cases(cases: Sequence[Case]) -> dict[tuple[int, int], PairedTest]:
    """Tests every model against every later one, where their cards read the same motion from the logs."""
    tests = {}
    for i, j in combinations(range(len(cases)), 2):
        one, other = cases[i], cases[j]
        if not one.flights or not all(map(same_motion, one.flights, other.flights)):
            continue
        first, second = ((each.validation.flights, each.validation.errors["model"]) for each in (one, other))
        tests[i, j] = paired_scores((one.path, other.path), first, second)
    return tests
