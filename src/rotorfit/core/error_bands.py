"""Coverage: how often the stated error bands of a prediction contained the truth."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Coverage:
    """Coverage of error bands.

    Attributes:
        nominal: Share of the errors that the bands should contain.
        coverage: Share that they contained.
        width: Mean half width: the band is prediction plus or minus this [m/s, m; rad/s, rad].
    """

    nominal: float
    coverage: float
    width: float


@dataclass(frozen=True)
class BandScore:
    """Coverage of the bands of one axis at one horizon.

    Attributes:
        n: Number of predictions.
        velocity: Velocity at the horizon, for each nominal share; empty for fewer than five predictions.
        position: Position at the horizon; empty likewise, and where only the velocity is measured.
    """

    n: int
    velocity: tuple[Coverage, ...]
    position: tuple[Coverage, ...]


Scores = Mapping[str, Mapping[str, BandScore]]
"""Axis name to horizon to score."""
