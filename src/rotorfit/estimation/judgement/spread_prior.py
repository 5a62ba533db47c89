"""How far flights of one vehicle differ, before any of them is flown: the scale of the prior on the spread.

The scale is in standard errors of a single flight. On recorded vehicles a spread that is in proportion to the error
describes the pairs of flights as well as one of fixed size, and it keeps a precise flight precise: what is left out of
a law, and out of a model of the wind, grows with what the flight leaves unknown.

Each scale maximises the likelihood of the differences between pairs of flights of nine recorded vehicles under the
default laws, beside what the tests of the law have found in them, averaged over the half t, on a grid from 0.3 to 3: a
rule, with nothing chosen by how many pairs agree (`bench/bench_spread_scales.py`).
"""

from collections.abc import Mapping

SPREAD: Mapping[str, float] = {
    "input": 0.3,
    "damping": 0.3,
    "delay": 1.2,
    "lag": 0.6,
    "zero": 0.6,
    "steady_gain": 0.3,
    "total_lag": 0.3,
    "delay_plus_lag": 0.4,
    "natural_frequency": 0.3,
    "damping_ratio": 0.9,
}
"""Scale of the half t of the spread, in standard errors of one flight, by coefficient or combination."""

OTHERS = 0.5
"""The same of further parameters, of which too few flights tell: that of all together."""


def spread_scale(name: str) -> float:
    """Scale of the spread of a coefficient or combination, in standard errors of one flight."""
    return SPREAD.get(name, OTHERS)
