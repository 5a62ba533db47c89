"""How often the error bands that a prediction stated held."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Coverage:
    """How often bands held.

    Attributes:
        nominal: Share of the errors that they are to hold.
        coverage: Share that they held.
        width: Mean half width, so that the band is prediction plus or minus this [m/s, m; rad/s, rad].
    """

    nominal: float
    coverage: float
    width: float


@dataclass(frozen=True)
class BandScore:
    """Bands of one axis at one horizon.

    Attributes:
        n: Predictions.
        velocity: Of the velocity at the horizon, for each nominal share; empty for fewer than five predictions.
        position: Of the position there; empty likewise, and where only the velocity is measured.
    """

    n: int
    velocity: tuple[Coverage, ...]
    position: tuple[Coverage, ...]


Scores = Mapping[str, Mapping[str, BandScore]]
"""Axis name to horizon to score."""
