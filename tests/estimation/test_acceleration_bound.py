"""A bound on the acceleration: told where it acts, by how much it biases, and only there."""

import math
from functools import cache

import pytest

from bounded_flights import BOUND, POINTS, flown
from flights import fit_as_flown
from rotorfit.core.model import COEFFICIENTS, Axis, Evidence
from rotorfit.core.results import Fit


@cache
def fitted(size: float, bound: float = math.inf, wind: float = 0.3) -> Fit:
    return fit_as_flown([flown(size, bound, wind)], axes=("x", "y"))


def evidence(axis: Axis) -> Evidence | None:
    return next((one for one in axis.evidence if one.test == "bound"), None)


def misses(axis: Axis, name: str) -> list[str]:
    truth = dict(zip(COEFFICIENTS, POINTS[name], strict=True))
    return [part for part, value in truth.items() if not inside(value, axis.ci95[part])]


def inside(value: float, ends: tuple[float | None, float | None]) -> bool:
    low, high = ends
    return (low is None or low <= value) and (high is None or value <= high)


def test_intervals_hold_the_vehicle_below_its_bound() -> None:
    axes = fitted(0.8, BOUND).model.axes

    for name in "xy":
        told = evidence(axes[name])
        assert told is not None
        assert float(told.strength.split("about ")[1].split()[0]) == pytest.approx(BOUND, rel=0.25)
        assert "m/s^2: chi-square" in told.strength
        assert misses(axes[name], name) == []
    assert not inside(POINTS["y"][0], axes["y"].ci95_flight["input"])


@pytest.mark.parametrize(("size", "bound"), [(0.8, math.inf), (0.2, BOUND)])
def test_nothing_is_told_without_a_bound_or_below_it(size: float, bound: float) -> None:
    axes = fitted(size, bound).model.axes

    assert [evidence(axes[name]) for name in "xy"] == [None, None]
