"""What a plan is expected to tell, as rows of text: the terminal and the picture show the same."""

import math
from collections.abc import Iterator

from rotorfit.frames import AXES
from rotorfit.model import COEFFICIENTS
from rotorfit.plan import Plan

UNITS = ("", " [1/s]", " [s]")
"""Of the coefficients; the input has that of its command."""

EXPECTED_HEADS = tuple(f"{name}{unit}" for name, unit in zip(COEFFICIENTS, UNITS, strict=True))

_Z95 = 1.96


def expected_rows(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Axis, and what is believed of its coefficients with half of the 95 % interval after the flight."""
    for axis, errors in plan.predicted["stderr"].items():
        a, belief = AXES.index(axis), plan.belief
        values = (*belief["gamma"][2 * a : 2 * a + 2], belief["delay"][a])
        yield axis, *(_plus_minus(v, _Z95 * errors[name]) for name, v in zip(COEFFICIENTS, values, strict=True))


def _plus_minus(value: float, half: float) -> str:
    """A value with half of its interval, two digits of that."""
    decimals = max(0, min(6, 1 - math.floor(math.log10(half)))) if 0 < half < math.inf else 3
    return f"{value:.{decimals}f} +- {half:.{decimals}f}"
