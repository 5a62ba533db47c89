"""Flights -> LeaveOneOut: every flight predicted by a model fitted without it, and how much these models differ."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rotorfit.assessment.innovations import placed
from rotorfit.assessment.paired import paired_scores
from rotorfit.assessment.validation import validate
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.model import COEFFICIENTS, Model
from rotorfit.core.progress import Progress
from rotorfit.core.results import HORIZONS, FlightScores, LeftOut, PairedTest, StartErrors
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.methods import BEST


@dataclass(frozen=True)
class LeaveOneOut:
    """Cross-validation over the flights.

    Attributes:
        flights: Scores of each flight by the model of the others.
        baselines: `hold` and `paper` (the paper's coefficients from the others) on the same flights.
        paired: The models against the baselines.
        spread: How the coefficients differ between the fits.
        notes: Axes that could not be left out on a flight, and why.
    """

    flights: tuple[FlightScores, ...]
    baselines: Mapping[str, tuple[FlightScores, ...]]
    paired: tuple[PairedTest, ...]
    spread: tuple[LeftOut, ...]
    notes: tuple[str, ...]


def leave_one_out(
    flights: Sequence[Flight],
    method: str = BEST,
    axes: Sequence[str] = AXES,
    horizons: Sequence[float] = HORIZONS,
    progress: Progress | None = None,
    structure: str = AVERAGED,
) -> LeaveOneOut:
    """Fits all flights but one and scores that one, for each in turn; nothing is averaged over the flights.

    Args:
        flights: At least two, read with one card. Parts of one log count as flights.
        method: As for `fit`.
        axes: As for `fit`.
        horizons: Prediction horizons [s].
        progress: Called with a fraction and a text; raising in it cancels.
        structure: As for `fit`; `auto` chooses anew each time.

    Raises:
        FlightError: Fewer than two flights; also as for `fit` and `validate`.

    Source: M. Stone, J. R. Statist. Soc. B 36 (1974), pp. 111-147; the standard error: B. Efron, C. Stein, Ann.
    Statist. 9 (1981), pp. 586-596.
    """
    require_two(len(flights))
    models, scores, errors = [], [], []
    for number, flight in enumerate(flights):
        if progress:
            progress(number / len(flights), f"all but {flight.path}")
        model = fit([*flights[:number], *flights[number + 1 :]], method, axes, structure=structure).model
        validation = validate(model, [placed(model, flight)], horizons)
        models.append(model)
        scores.append({"model": validation.flights[0], **{name: b[0] for name, b in validation.baselines.items()}})
        errors.append({name: each[0] for name, each in validation.errors.items()})
    by_name = {name: tuple(each[name] for each in scores) for name in scores[0]}
    moved = [each.moved for each in by_name["model"]]
    return LeaveOneOut(
        flights=by_name["model"],
        baselines={name: by_name[name] for name in ("hold", "paper")},
        paired=tuple(_paired(errors, by_name, name) for name in ("hold", "paper")),
        spread=tuple(s for axis in AXES if axis in axes for s in _spreads(axis, models, moved)),
        notes=tuple(n for axis in AXES if axis in axes for n in _notes(axis, models, by_name["model"])),
    )


def require_two(count: int) -> None:
    """Checks that there are at least two flights.

    Raises:
        FlightError: Fewer than two flights.
    """
    if count < 2:
        raise FlightError(
            "one flight cannot be left out of itself: give at least two logs, or parts of one as LOG@:60 LOG@60:"
        )


def _paired(
    errors: Sequence[Mapping[str, Mapping[str, StartErrors]]], scores: Mapping[str, Sequence[FlightScores]], name: str
) -> PairedTest:
    first, second = ((scores[which], [each[which] for each in errors]) for which in ("model", name))
    return paired_scores(("model", name), first, second)


def _spreads(axis: str, models: Sequence[Model], moved: Sequence[tuple[str, ...]]) -> list[LeftOut]:
    """The coefficients and combinations of one axis."""
    out = []
    pairs = list(zip(models, moved, strict=True))
    for name in (*COEFFICIENTS, "steady_gain", "total_lag"):
        values = [_value(model, axis, name) if axis in moves else None for model, moves in pairs]
        known = np.array([value for value in values if value is not None])
        if not known.size:
            continue
        movers = sum(axis in moves for moves in moved)
        whole = known.size == movers and movers > 1
        jackknife = float(np.sqrt((movers - 1) / movers * np.sum((known - known.mean()) ** 2))) if whole else None
        out.append(LeftOut(axis, name, tuple(values), float(known.min()), float(known.max()), jackknife))
    return out


def _value(model: Model, axis: str, name: str) -> float | None:
    known = model.axes[axis]
    if name in COEFFICIENTS:
        return None if known.predictor is None else float(getattr(known.predictor, name))
    return known.combinations[name].value if name in known.combinations else None


def _notes(axis: str, models: Sequence[Model], flights: Sequence[FlightScores]) -> list[str]:
    """Why flights have no score on this axis, one line per flight."""
    movers = [flight for flight in flights if axis in flight.moved]
    if len(movers) == 1:
        return [f"{axis}: only {movers[0].path} moves it, so it cannot be left out: {axis} is not tested"]
    return [
        f"{axis}: without {flight.path} the others do not determine it ({model.axes[axis].status['input']})"
        for model, flight in zip(models, flights, strict=True)
        if axis in flight.moved and model.axes[axis].predictor is None
    ]


def leave_one_out_mapping(result: LeaveOneOut) -> dict[str, Any]:
    """The result as plain JSON types, as stored in the model file."""
    return {
        "flights": [asdict(flight) for flight in result.flights],
        "baselines": {
            name: {"flights": [asdict(flight) for flight in flights]} for name, flights in result.baselines.items()
        },
        "paired": [asdict(test) for test in result.paired],
        "spread": [asdict(spread) for spread in result.spread],
        "notes": list(result.notes),
    }
