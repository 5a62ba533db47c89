"""What the terminal shows of the ladder: every method below the other, axis by axis."""

import math

from rich.text import Text

from rotorfit.ladder import Ladder, Row
from rotorfit.model import COEFFICIENTS
from rotorfit.terminal.tables import View, bullets, table, three_digits, title


def ladder_view(ladder: Ladder) -> View:
    """All rungs of each axis, one below the other, with what they say of themselves."""
    yield title(f"Every method on {', '.join(ladder.paths)}")
    for axis, rows in ladder.axes.items():
        shown = table(axis, *COEFFICIENTS, "1 s", "against ml", left=(0, 5), gap=3)
        scale = 180 / math.pi if axis == "yaw" else 100.0
        for row in rows:
            values = [_plus_minus(getattr(row.axis, name), row.axis.stderr[name]) for name in COEFFICIENTS]
            error = "-" if row.prediction is None else three_digits(scale * row.prediction)
            shown.add_row(row.method, *values, error, _verdict(row, rows[-1].method))
        if (held := ladder.held[axis]) is not None:
            shown.add_row("hold", "", "", "", three_digits(scale * held), "", style="dim")
        yield ""
        yield shown
        yield from bullets([f"{row.method}: {row.remark}" for row in rows if row.remark])
    yield Text(
        "+-: standard error; 1 s: RMSE of 1 s velocity predictions on these very flights [cm/s, yaw deg/s], hold keeps "
        "the velocity; against ml: coefficients that differ from the likelihood's at 1 %.",
        style="dim",
    )


def _plus_minus(value: float | None, error: float | None) -> str:
    """A value and its standard error, with two digits of the error."""
    if value is None or error is None:
        return "-"
    decimals = max(0, min(6, 1 - math.floor(math.log10(error)))) if error > 0 else 3
    return f"{value:.{decimals}f} +- {error:.{decimals}f}"


def _verdict(row: Row, best: str) -> str:
    """What an agreement test says of a rung."""
    if all(getattr(row.axis, name) is None for name in COEFFICIENTS):
        return row.axis.status["input"]
    if not row.agreement:
        return "" if row.method == best else f"no number of {best}"
    differing = [name for name, test in row.agreement.items() if not test.agrees]
    return f"differs: {', '.join(differing)}" if differing else "agrees"
