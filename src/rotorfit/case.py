"""Model files and logs -> Cases: each model with what speaks for it and against it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from rotorfit.flight import Flight
from rotorfit.forecast import CURVE
from rotorfit.log_span import parse_log
from rotorfit.model import Model
from rotorfit.model_file import is_model_file, load
from rotorfit.paired import PairedTest, paired_test
from rotorfit.pipeline import same_motion, training_flights, validate_logs
from rotorfit.validation import Validation

Progress = Callable[[float, str], None]

UNPROVEN = Validation((), {"hold": (), "paper": ()})
"""Of a model that no flight was kept for."""


@dataclass(frozen=True)
class Case:
    """A model and its proof.

    Attributes:
        path: Of the model file.
        model: With its findings.
        training: The flights that it was fitted to; empty where they are not at hand.
        validation: Its scores; without flights where there are none.
        flights: The flights of the scores, in their order; empty where they are not at hand.
    """

    path: str
    model: Model
    training: tuple[Flight, ...] = ()
    validation: Validation = UNPROVEN
    flights: tuple[Flight, ...] = ()


def cases_of(paths: Sequence[str], progress: Progress | None = None) -> tuple[tuple[Case, ...], tuple[str, ...]]:
    """Scores every model on every log, each by its own card.

    Args:
        paths: A model file, then logs and further models in any order, told apart by content; a log may be
            `LOG@T0:T1`. Without a log nothing is proven.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The cases, and one line about each training flight that could not be read again.

    Raises:
        ModelError: The first path is no model.
        LogError: A log cannot be read.
    """
    files = [path for k, path in enumerate(paths) if k == 0 or (Path(path).is_file() and is_model_file(path))]
    models = [load(path) for path in files]
    logs = [parse_log(path) for path in paths if path not in files]
    cases: list[Case] = []
    notes: list[str] = []
    for number, (path, model) in enumerate(zip(files, models, strict=True)):

        def report(fraction: float, text: str, done: int = number) -> None:
            if progress:
                progress((done + fraction) / len(files), f"{files[done]} on {text}")

        training, left_out = training_flights(model)
        scored = (
            validate_logs(model, logs, horizons=CURVE, progress=report, beside=training) if logs else (UNPROVEN, ())
        )
        cases.append(Case(path, model, training, *scored))
        notes += left_out
    return tuple(cases), tuple(dict.fromkeys(notes))


def paired_cases(cases: Sequence[Case]) -> dict[tuple[int, int], PairedTest]:
    """Every model against every later one, as far as their cards read the same motion from the logs."""
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
