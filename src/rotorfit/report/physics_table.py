"""The model in physics, ready to print: accelerations, speeds and times beside what the card makes one expect."""

from dataclasses import dataclass

from rotorfit.model import Model
from rotorfit.physics import implied_limits, physics_rows
from rotorfit.report.words import rounded
from rotorfit.settings import Figure


@dataclass(frozen=True)
class PhysicsText:
    """The table as text: axis, quantity, estimate, interval, unit, expected and ratio a row; and lines below it."""

    rows: tuple[tuple[str, ...], ...]
    lines: tuple[str, ...]


def physics_text(model: Model) -> PhysicsText:
    """What the report says of a model in physics; nothing where the card gives no command a meaning."""
    rows = tuple(
        (
            row.axis,
            row.name.replace("_", " "),
            rounded(row.measured.value, _width(row.measured)),
            _interval(row.measured),
            row.unit,
            "" if row.expected is None else rounded(row.expected),
            _ratio(row.ratio),
        )
        for row in physics_rows(model)
    )
    return PhysicsText(rows, implied_limits(model))


def _width(figure: Figure) -> float | None:
    """A quarter of the interval's width: about a standard error."""
    low, high = figure.ci95
    return None if low is None or high is None else (high - low) / 4


def _interval(figure: Figure) -> str:
    if figure.ci95 == (None, None):
        return "—"
    return " to ".join("open" if end is None else rounded(end, _width(figure)) for end in figure.ci95)


def _ratio(ratio: Figure | None) -> str:
    if ratio is None or ratio.value is None:
        return ""
    return f"{rounded(ratio.value, _width(ratio))} ({_interval(ratio)})"
