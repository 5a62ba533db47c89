"""Comparison: several models scored on the same logs, each by its own card, and tests whether they differ."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

from rotorfit.app.workflows import part_of_model, validate_logs
from rotorfit.assessment.case import reservations, same_motion
from rotorfit.assessment.paired import paired_scores
from rotorfit.assessment.validation import to_mapping
from rotorfit.core.card import Card
from rotorfit.core.display import FrameLibrary, columns_of, frame
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import told_together
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.core.progress import Progress
from rotorfit.core.results import HORIZONS, SCORE_COLUMNS, FlightScores, PairedTest, Validation, pool_lines
from rotorfit.files.log_span import LogSpan, parse_log
from rotorfit.files.models import is_model_file, load

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class Comparison:
    """Several models on the same logs.

    Attributes:
        paths: Paths of the model files, or names of the models.
        validations: One for each model, in that order.
        paired: `model 2` and later against `model 1`, and each against its own baselines `hold` and `paper`.
        notes: What could not be compared, or only with reservations, and why.
    """

    paths: tuple[str, ...]
    validations: tuple[Validation, ...]
    paired: tuple[PairedTest, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def baselines(self) -> Mapping[str, tuple[FlightScores, ...]]:
        """Scores of the baselines; of each axis those of the first model that has numbers of it."""
        known = {
            axis: next((one for one in self.validations if _predicts(one, axis)), self.validations[0]) for axis in AXES
        }
        return {
            name: tuple(
                replace(flight, axes={axis: one.baselines[name][number].axes[axis] for axis, one in known.items()})
                for number, flight in enumerate(flights)
            )
            for name, flights in self.validations[0].baselines.items()
        }

    def __repr__(self) -> str:
        return "\n\n".join(f"{name}: {one!r}" for name, one in zip(self.paths, self.validations, strict=True))

    def _repr_html_(self) -> str:
        parts = zip(self.paths, self.validations, strict=True)
        return "".join(f"<h4>{escape(name)}</h4>{one._repr_html_()}" for name, one in parts)

    @overload
    def to_frame(self, library: Literal["polars"] = "polars") -> "pl.DataFrame": ...
    @overload
    def to_frame(self, library: Literal["pandas"]) -> Any: ...
    def to_frame(self, library: FrameLibrary = "polars") -> Any:
        """The prediction errors as a data frame: the column `model`, then those of `Validation.to_frame`.

        Args:
            library: `polars`, or `pandas`, which must be installed.

        Raises:
            ModuleNotFoundError: pandas is asked for and not installed.
        """
        parts = zip(self.paths, self.validations, strict=True)
        rows = [(name, *row) for name, one in parts for row in one.rows()]
        return frame(columns_of(("model", *SCORE_COLUMNS), rows), library)


def _predicts(validation: Validation, axis: str) -> bool:
    return any(
        horizon.velocity_rmse is not None
        for flight in validation.flights
        for horizon in flight.axes[axis].horizons.values()
    )


def compare_logs(
    paths: Sequence[str], horizons: Sequence[float] = HORIZONS, progress: Progress | None = None
) -> Comparison:
    """Scores several models on the same logs, each by its own card.

    Args:
        paths: Model files and logs in any order, told apart by content; a log may be `LOG@T0:T1`.
        horizons: How far to predict [s].
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        ModelError: There is no model among the paths.
        FlightError: There is no log among them.
    """
    files = [path for path in paths if Path(path).is_file() and is_model_file(path)]
    logs = [parse_log(path) for path in paths if path not in files]
    if not files:
        raise ModelError(f"no model among {', '.join(paths)}; give files written by `rotorfit fit -o` before the logs")
    return compare_models(files, [load(path) for path in files], logs, horizons=horizons, progress=progress)


UNFAIR = ("commands_reveal_wind", "other_axis_unknown")
"""Findings on flights whose scores are not those of the coefficients alone."""


def compare_models(
    names: Sequence[str],
    models: Sequence[Model],
    logs: Sequence[LogSpan | Flight],
    card: str | Card | None = None,
    horizons: Sequence[float] = HORIZONS,
    progress: Progress | None = None,
) -> Comparison:
    """As `compare_logs`, for models in memory; `names` are those of their files or others."""
    validations, flights = [], []
    for number, model in enumerate(models):
        part = part_of_model(progress, number, names)
        validation, seen = validate_logs(model, logs, card, horizons, part)
        validations.append(validation)
        flights.append(seen)
    alike = [all(map(same_motion, seen, flights[0])) for seen in flights]
    notes = [
        f"model {number}: its card reads other motion from these logs than that of model 1: no paired test with it"
        for number, same in enumerate(alike, 1)
        if not same
    ]
    notes += reservations([f"model {number}" for number in range(1, len(names) + 1)], models, validations)
    biased = dict.fromkeys(one for each in validations for one in each.findings if one.code in UNFAIR)
    notes += [f"{one.evidence}: {one.effect}" for one in told_together(biased)]
    paired = _paired(validations, alike)
    notes += pool_lines(validations[0].flights, paired)
    return Comparison(tuple(names), tuple(validations), paired, tuple(notes))


def _paired(validations: Sequence[Validation], alike: Sequence[bool]) -> tuple[PairedTest, ...]:
    """Each model against the first, and against its own baselines."""
    first = validations[0]
    tests = []
    for number, (validation, same) in enumerate(zip(validations, alike, strict=True), 1):
        others = [("model 1", first.flights, first.errors["model"])] if same and number > 1 else []
        others += [(name, validation.baselines[name], validation.errors[name]) for name in ("hold", "paper")]
        own = validation.flights, validation.errors["model"]
        tests += [paired_scores((f"model {number}", name), own, (scores, errors)) for name, scores, errors in others]
    return tuple(tests)


def comparison_mapping(comparison: Comparison) -> dict[str, Any]:
    """The comparison as plain JSON types."""
    mappings = [to_mapping(validation) for validation in comparison.validations]
    pairs = zip(comparison.paths, mappings, strict=True)
    return {
        "models": [{"path": path, "flights": mapping["flights"]} for path, mapping in pairs],
        "baselines": {
            name: {"flights": [asdict(flight) for flight in flights]} for name, flights in comparison.baselines.items()
        },
        "paired": [asdict(test) for test in comparison.paired],
        "notes": list(comparison.notes),
    }
