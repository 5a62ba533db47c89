"""Terms that the law leaves out: told where they act, by how much they bias, and only there."""

import math
from functools import cache

import pytest

from limited_flights import BOUND, POINTS, flown, looped
from rotorfit.assessment.law_findings import law_findings
from rotorfit.core.model import COEFFICIENTS, Axis, Evidence
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit


@cache
def fitted(
    size: float,
    bound: float = math.inf,
    wind: float = 0.3,
    jerk: float = math.inf,
    drag: float = 0.0,
    structure: str = "first_order_delay",
) -> Fit:
    return fit([flown(size, bound, wind, jerk=jerk, drag=drag)], axes=("x", "y"), structure=structure)


def evidence(axis: Axis, kind: str) -> Evidence:
    return next(one for one in axis.evidence if one.test == kind)


def told(axis: Axis) -> set[str]:
    return {one.test for one in axis.evidence} & {"bound", "jerk", "drag", "slow"}


def size_of(found: Evidence) -> float:
    return float(found.strength.split("about ")[1].split()[0])


def misses(axis: Axis, name: str) -> list[str]:
    truth = dict(zip(COEFFICIENTS, POINTS[name], strict=True))
    return [part for part, value in truth.items() if not inside(value, axis.ci95[part])]


def inside(value: float, ends: tuple[float | None, float | None]) -> bool:
    low, high = ends
    return (low is None or low <= value) and (high is None or value <= high)


def test_intervals_hold_the_vehicle_below_its_bound() -> None:
    axes = fitted(0.8, BOUND).model.axes

    for name in "xy":
        assert told(axes[name]) == {"bound"}
        assert size_of(evidence(axes[name], "bound")) == pytest.approx(BOUND, rel=0.25)
        assert "m/s^2: chi-square" in evidence(axes[name], "bound").strength
        assert "fit with --structure limited_acceleration" in next(law_findings(name, axes[name])).remedy
        assert misses(axes[name], name) == []
    assert not inside(POINTS["y"][0], axes["y"].ci95_flight["input"])


def test_the_law_with_a_limit_tells_what_the_law_without_it_leaves_wide() -> None:
    wide, axes = fitted(0.8, BOUND).model.axes, fitted(0.8, BOUND, structure="limited_acceleration").model.axes

    for name in "xy":
        assert inside(BOUND, axes[name].ci95["acceleration_limit"])
        assert told(axes[name]) == set()
        narrow, other = (one[name].ci95["input"] for one in (axes, wide))
        assert narrow[1] - narrow[0] < 0.6 * (other[1] - other[0])  # type: ignore[operator]


def test_intervals_hold_the_vehicle_whose_acceleration_changes_slowly() -> None:
    axes = fitted(0.6, jerk=20.0, structure="first_order_delay_lag").model.axes

    for name in "xy":
        axis = axes[name]
        assert told(axis) == {"jerk"}
        assert size_of(evidence(axis, "jerk")) == pytest.approx(20.0, rel=0.25)
        assert "m/s^3: chi-square" in evidence(axis, "jerk").strength
        assert set(misses(axis, name)) <= {"delay"}  # a lag that is not there takes part of it
        assert not inside(1.05 * POINTS[name][2], axis.combinations["delay_plus_lag"].ci95_flight)
        assert inside(1.05 * POINTS[name][2], axis.combinations["delay_plus_lag"].ci95)


def test_the_damping_at_hover_is_not_that_at_speed() -> None:
    axes = fitted(0.6, wind=0.1, drag=0.8).model.axes

    for name in "xy":
        axis = axes[name]
        assert told(axis) == {"drag"}
        assert size_of(evidence(axis, "drag")) == pytest.approx(0.8, rel=0.4)
        assert misses(axis, name) == []
        assert not inside(POINTS[name][1], axis.ci95_flight["damping"])
        assert "fit with --structure quadratic_drag" in next(law_findings(name, axis)).remedy


@pytest.mark.parametrize(("size", "bound"), [(0.8, math.inf), (0.2, BOUND)])
def test_nothing_is_told_without_a_limit_or_below_it(size: float, bound: float) -> None:
    axes = fitted(size, bound).model.axes

    assert [told(axes[name]) for name in "xy"] == [set(), set()]


def test_a_loop_with_an_integral_part_ends_at_what_is_commanded_and_its_law_is_doubted() -> None:
    axis = fit([looped(3.0)], axes=("x",), structure="first_order_delay_lag").model.axes["x"]

    assert told(axis) == {"slow"}
    assert "% less acceleration than short ones" in evidence(axis, "slow").strength
    assert inside(1.0, axis.combinations["steady_gain"].ci95)
    assert not inside(1.0, axis.combinations["steady_gain"].ci95_flight)
    assert "of 9 s and more" in next(law_findings("x", axis)).remedy
