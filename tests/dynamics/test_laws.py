"""Laws of the estimator: exactness without noise, symmetries, additivity.

Of the first-order law; what the default laws add keeps the symmetries, too.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flights import STILL, Excitation, flown, steps, truth_of, turned
from other_laws import flown_by
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.models import to_mapping
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import GAMMA_A, GAMMA_B, GAMMA_F, Truth

pytestmark = pytest.mark.flights

QUIET = Truth()
"""The demo's wind and mocap."""


def fitted(*flights: Flight, axes: tuple[str, ...] = AXES, structure: str = "first_order_delay") -> Model:
    return fit(flights, axes=axes, structure=structure).model


def numbers(model: Model, axes: tuple[str, ...] = AXES) -> np.ndarray:
    """Input, damping, delay of each axis, shape (K, 3)."""
    return np.array([[getattr(model.axes[axis], name) for name in COEFFICIENTS] for axis in axes], float)


def truths(truth: Truth, axes: tuple[str, ...] = AXES) -> np.ndarray:
    return np.array([list(truth_of(truth, axis).values()) for axis in axes])


# Without noise


@pytest.mark.parametrize("gamma", [GAMMA_A, GAMMA_B, GAMMA_F], ids=["A", "B", "F"])
def test_without_noise_z_and_yaw_come_back_exactly(gamma: tuple[float, ...]) -> None:
    """The response is exact, the levels fall to their floor: what is left is the rounding of the stamps, 1 ns."""
    truth = replace(STILL, gamma=gamma)
    found = numbers(fitted(flown(truth, two_sines, 20.0), axes=("z", "yaw")), ("z", "yaw"))

    np.testing.assert_allclose(found, truths(truth, ("z", "yaw")), rtol=1e-6)


def test_without_noise_x_and_y_come_back_under_a_held_yaw() -> None:
    """Exact too; the held heading is only known as far as the quaternion is, 1e-16."""
    flight = flown(STILL, steps(("x", "y")), 20.0, initial_yaw=0.9)

    assert np.ptp(flight.yaw) < 1e-9
    np.testing.assert_allclose(
        numbers(fitted(flight, axes=("x", "y")), ("x", "y")), truths(STILL, ("x", "y")), rtol=1e-6
    )


@pytest.mark.parametrize("excitation", [two_sines, steps()], ids=["sines", "steps"])
def test_without_noise_x_and_y_come_back_under_a_turning_yaw_to_a_ten_thousandth(excitation: Excitation) -> None:
    """Between poses, 8 ms, the heading is taken as straight in time and, in a step, as that of its middle."""
    flight = flown(STILL, excitation, 40.0, initial_yaw=0.4)

    assert np.ptp(flight.yaw) > 2.0
    np.testing.assert_allclose(
        numbers(fitted(flight, axes=("x", "y")), ("x", "y")), truths(STILL, ("x", "y")), rtol=2e-4
    )


def test_each_axis_has_a_delay_of_its_own() -> None:
    truth = replace(STILL, delay=(0.07, 0.21, 0.0, 0.33))

    found = numbers(fitted(flown(truth, steps(), 18.0)))
    np.testing.assert_allclose(found[:, 2], truth.delay, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found[:, :2], truths(truth)[:, :2], rtol=1e-3)


def test_a_trim_is_told_apart_from_the_coefficients() -> None:
    truth = replace(STILL, trim=(0.08, -0.05, 0.1, 0.03))
    model = fitted(flown(truth, steps(), 18.0))

    np.testing.assert_allclose(numbers(model), truths(truth), rtol=1e-3)
    np.testing.assert_allclose([model.axes[axis].trim[0] for axis in AXES], truth.trim, rtol=2e-2)


def assert_within(found: np.ndarray, expected: np.ndarray, most: np.ndarray) -> None:
    """Every difference is at most so large."""
    np.testing.assert_array_less(np.abs(found - expected), most)


# Symmetries


@cache
def noisy() -> tuple[Flight, Model]:
    flight = flown(QUIET, steps(), 25.0, 5)
    return flight, fitted(flight)


def errors(model: Model) -> np.ndarray:
    """Standard errors of the flights alone, from their intervals, shape (4, 3)."""
    axes = (model.axes[axis].ci95_flight for axis in AXES)
    ends = np.array([[own.get(name, (None, None)) for name in COEFFICIENTS] for own in axes], float)
    return np.ptp(ends, axis=2) / (2 * 1.96)


def test_turning_the_world_turns_nothing() -> None:
    flight, model = noisy()

    other = fitted(turned(flight, 2.1))
    assert_within(numbers(other), numbers(model), 0.02 * errors(model))
    np.testing.assert_allclose(errors(other), errors(model), rtol=0.02)


def test_moving_the_world_moves_nothing() -> None:
    flight, model = noisy()

    other = fitted(
        replace(flight, position=flight.position + np.array([300.0, -200.0, 50.0]), yaw=flight.yaw + 4 * np.pi)
    )
    assert_within(numbers(other), numbers(model), 0.02 * errors(model))


def test_scaling_the_commands_scales_the_inputs_alone() -> None:
    flight, model = noisy()
    factor = np.array([0.1, 7.0, -2.0, 57.3])

    other = fitted(replace(flight, command=flight.command * factor))
    expected, spread = numbers(model), errors(model)
    expected[:, 0] /= factor
    spread[:, 0] /= np.abs(factor)
    assert_within(numbers(other), expected, 0.2 * spread)


def test_scaling_the_lengths_scales_inputs_and_noise_alone() -> None:
    flight, model = noisy()

    other = fitted(replace(flight, position=flight.position * 3.0))
    expected, spread = numbers(model), errors(model)
    expected[:3, 0] *= 3.0
    spread[:3, 0] *= 3.0
    assert_within(numbers(other), expected, 0.05 * spread)
    for axis in AXES[:3]:
        assert other.axes[axis].noise["pose_variance"] == pytest.approx(
            9 * model.axes[axis].noise["pose_variance"], rel=0.02
        )


@pytest.mark.parametrize("shift", [-0.05, pytest.param(0.08, marks=pytest.mark.slow)])
def test_shifting_the_clock_of_the_commands_shifts_the_delay(shift: float) -> None:
    flight, model = noisy()
    early = replace(
        flight,
        command_time=flight.command_time - shift,
        segments=tuple(replace(s, start=s.start - shift, end=s.end - shift) for s in flight.segments),
    )

    found = numbers(fitted(early))
    np.testing.assert_allclose(found[:, 2], numbers(model)[:, 2] + shift, rtol=0, atol=0.002)
    np.testing.assert_allclose(found[:, :2], numbers(model)[:, :2], rtol=0.02)


def test_shifting_all_clocks_shifts_nothing() -> None:
    flight, model = noisy()
    later = replace(
        flight,
        command_time=flight.command_time + 1000.0,
        pose_time=flight.pose_time + 1000.0,
        segments=tuple(replace(s, start=s.start + 1000.0, end=s.end + 1000.0) for s in flight.segments),
    )

    assert_within(numbers(fitted(later)), numbers(model), 0.05 * errors(model))


@pytest.mark.parametrize(
    "name", [pytest.param("first_order_delay", marks=pytest.mark.slow), "first_order_delay_lag", "second_order_zero"]
)
def test_the_default_laws_keep_the_symmetries(name: str) -> None:
    """Clocks that run 1000 s later, commands twice as large and turned round: inputs halved and turned, no more."""
    flight = flown_by(name, duration=30.0, seed=4, wind=0.05, noise=0.001)
    other = replace(
        flight,
        command=-2.0 * flight.command,
        command_time=flight.command_time + 1000.0,
        pose_time=flight.pose_time + 1000.0,
        segments=tuple(replace(s, start=s.start + 1000.0, end=s.end + 1000.0) for s in flight.segments),
    )

    one, two = (fitted(f, axes=("z",), structure="averaged").axes["z"] for f in (flight, other))
    assert two.structure == one.structure == name
    assert two.status == one.status
    for key, ends in one.ci95_flight.items():
        factor = -0.5 if key == "input" else 1.0
        expected = sorted(factor * end for end in ends if end is not None)
        assert sorted(end for end in two.ci95_flight[key] if end is not None) == pytest.approx(
            expected, rel=0.02, abs=2e-3
        )
    assert [law.weight for law in two.laws] == pytest.approx([law.weight for law in one.laws], abs=0.02)


# Several flights


def test_one_flight_in_two_spans_says_nearly_the_same_as_in_one() -> None:
    """Lost are 0.6 s of the second span, and what its trim and start cost; and two flights may differ by a spread."""
    whole, *parts = (flown(QUIET, steps(), 40.0, 7, span=span) for span in ((None, None), (None, 20.0), (20.0, None)))

    one, two = fitted(whole), fitted(*parts)
    assert_within(numbers(two), numbers(one), 0.8 * errors(one))
    np.testing.assert_allclose(errors(two), errors(one), rtol=0.25)


def test_what_two_flights_know_adds_up() -> None:
    first, second = (flown(QUIET, steps(seed=seed), 20.0, seed) for seed in (11, 12))

    one, other, both = (errors(fitted(*flights)) for flights in ([first], [second], [first, second]))
    expected = 1 / np.sqrt(1 / one**2 + 1 / other**2)
    np.testing.assert_allclose(both, expected, rtol=0.25)
    assert (both < np.minimum(one, other)).all()


def test_the_order_of_flights_does_not_matter() -> None:
    first, second = (flown(QUIET, steps(("z", "yaw"), seed=seed), 20.0, seed) for seed in (11, 12))
    axes = ("z", "yaw")

    one, other = fitted(first, second, axes=axes), fitted(second, first, axes=axes)
    spread = errors(one)[2:]
    assert_within(numbers(other, axes), numbers(one, axes), 0.05 * spread)
    for axis in axes:
        trims = [model.axes[axis].trim for model in (one, other)]
        np.testing.assert_allclose(trims[1], trims[0][::-1], rtol=0, atol=2e-3)


def test_a_flight_that_does_not_move_an_axis_says_nothing_about_it() -> None:
    z, yaw = flown(QUIET, steps(("z",)), 30.0, 11), flown(QUIET, steps(("yaw",)), 30.0, 12)

    both = fitted(z, yaw)
    np.testing.assert_array_equal(numbers(both, ("z",)), numbers(fitted(z), ("z",)))
    np.testing.assert_array_equal(numbers(both, ("yaw",)), numbers(fitted(yaw), ("yaw",)))
    assert both.axes["z"].trim[1] is None
    assert both.axes["yaw"].trim[0] is None
    assert [source.axes for source in both.flights] == [("z",), ("yaw",)]


def test_the_same_flights_give_the_same_model_to_the_last_digit() -> None:
    flight, _ = noisy()

    one, other = (to_mapping(fitted(flight, axes=("z",), structure="averaged")) for _ in range(2))
    assert one == other
