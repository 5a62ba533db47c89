"""How far flights of one vehicle differ, before any of them is flown: the scale of the prior on the spread.

The scale is in standard errors of a single flight. On recorded vehicles a spread that is in proportion to the error
describes the pairs of flights as well as one of fixed size, and it keeps a precise flight precise: what is left out of
a law, and out of a model of the wind, grows with what the flight leaves unknown.

Each scale maximises the restricted likelihood of the flights of nine recorded vehicles under `first_order_delay_lag`,
averaged over the half t, on a grid from 0.05 to 2.2: a rule, with nothing chosen by how many pairs agree.
"""

from collections.abc import Mapping

SPREAD: Mapping[str, float] = {
    "input": 0.5,
    "damping": 0.6,
    "delay": 0.8,
    "lag": 1.7,
    "steady_gain": 0.05,
    "total_lag": 1.3,
    "delay_plus_lag": 0.5,
}
"""Scale of the half t of the spread, in standard errors of one flight, by coefficient or combination."""

OTHERS = 0.6
"""The same of further parameters, of which too few flights tell."""


def spread_scale(name: str) -> float:
    """Scale of the spread of a coefficient or combination, in standard errors of one flight."""
    return SPREAD.get(name, OTHERS)
