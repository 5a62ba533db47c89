"""The scale of the prior on the spread between flights of one vehicle.

The scale is in standard errors of a single flight. For recorded vehicles a spread in proportion to the error describes
the pairs of flights as well as one of fixed size, and it keeps a precise flight precise: the effect of what a law, and
a model of the wind, leave out grows with the uncertainty of the flight.

Each scale maximises the likelihood of the differences between pairs of flights of nine recorded vehicles under the
default laws, in addition to the factors found by the tests of the law, averaged over the half t, on a grid from 0.3 to
3. This is a rule: nothing is chosen by how many pairs agree (`bench/bench_spread_scales.py`).
"""

DELAY = 0.7
"""Scale of the half t of the spread of the delay, in standard errors of one flight."""

OTHERS = 0.3
"""The same of every other coefficient or combination: the smallest of the grid, which each of them takes by itself."""


def spread_scale(name: str) -> float:
    """Scale of the half t of the spread of a coefficient or combination, in standard errors of one flight."""
    return DELAY if name == "delay" else OTHERS
