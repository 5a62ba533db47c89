"""What a plan is expected to tell, as a table of text: for the terminal and for the picture."""

import math

from rotorfit.frames import AXES
from rotorfit.model import COEFFICIENTS
from rotorfit.plan import Plan

Z95 = 1.96
"""Half width of a 95 % interval in standard errors."""

HEADS = ("input", "damping [1/s]", "delay [s]")
"""Of the columns; the input is per unit of its command."""


def known_after(plan: Plan) -> dict[str, list[str]]:
    """Axis to input, damping and delay as believed, each with half of the 95 % interval that is expected."""
    out = {}
    for axis, errors in plan.predicted["stderr"].items():
        a = AXES.index(axis)
        values = (plan.belief["gamma"][2 * a], plan.belief["gamma"][2 * a + 1], plan.belief["delay"][a])
        pairs = zip(COEFFICIENTS, values, strict=True)
        out[axis] = [plus_minus(value, Z95 * errors[name]) for name, value in pairs]
    return out


def plus_minus(value: float, half: float) -> str:
    """A value with half of its interval, two digits of that."""
    decimals = max(0, min(6, 1 - math.floor(math.log10(half)))) if 0 < half < math.inf else 3
    return f"{value:.{decimals}f} +- {half:.{decimals}f}"
