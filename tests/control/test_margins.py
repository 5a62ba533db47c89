"""Margins of the sampled loop: against a simulation of the delay-differential equation, and against python-control."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.control.control_law import KINDS, AxisLaw, Kind, law_of_bandwidth, linear_system
from rotorfit.control.controller import AxisControllers, ReferencePath, at_rest, commanded, observe
from rotorfit.control.loop_vehicle import LaggedAxis, LoopVehicle
from rotorfit.control.margins import (
    closed_loop,
    law_response,
    margins,
    open_loop,
    spectral_radius,
    vehicle_response,
)
from rotorfit.control.robustness import doubt, robustness
from rotorfit.core.laws import structure_named
from rotorfit.core.model import Predictor
from rotorfit.dynamics.transfer_function import law_response as velocity_per_command
from rotorfit.planning.axis_information import AxisBelief

VEHICLE = AxisBelief(3.7, 0.18, 0.17)
PERIOD, LATENCY = 0.02, 0.015
HERE = ReferencePath("steps", 1.0, 1.0, centre=(0.0, 0.0, 0.0, 0.0))
"""Nowhere to go within its first seconds."""


def law_for(kind: Kind, bandwidth: float, vehicle: AxisBelief = VEHICLE) -> AxisLaw:
    return law_of_bandwidth(kind, vehicle, bandwidth, PERIOD, LATENCY, 0.03)


BANDWIDTH = {"predictor": 2.0, "lqr": 2.0, "linearising": 1.2}
LAWS = {kind: law_for(kind, BANDWIDTH[kind]) for kind in KINDS}


def rates(vehicle: LoopVehicle, v: float, q: float, u: float) -> tuple[float, float]:
    """Derivatives of the velocity and of the third state, written from the laws in `core.laws`."""
    if isinstance(vehicle, AxisBelief):
        return vehicle.gain * u - vehicle.damping * v, 0.0
    g, b, _, T, Z, order = vehicle
    if order == 1:
        return q - b * v, (g * u - q) / T
    return q + g * Z / T * u, (g * u - b * v - (q + g * Z / T * u)) / T


def flown(law: AxisLaw, vehicle: LoopVehicle, duration: float) -> np.ndarray:
    """Position at every command, from 0.1 m off: the controller as it flies, its vehicle in steps of half a ms.

    Time is kept short of the path's first step by starting long before it.
    """
    controller, fine, t0 = AxisControllers({"x": law}, np.full(4, np.inf)), 0.0005, -duration
    steering = at_rest(np.zeros(4), t0 - LATENCY - PERIOD)
    per, late = round(PERIOD / fine), round(LATENCY / fine)
    held, out, p, v, q = [0.0] * round(vehicle.delay / fine), [], 0.1, 0.0, 0.0
    past = [p] * (late + 1)
    for k in range(int(duration / PERIOD)):
        t = t0 + k * PERIOD
        steering = observe(controller, steering, t - LATENCY, np.array([past[-1 - late], 0.0, 0.0, 0.0]), HERE)
        steering, command = commanded(controller, steering, t, HERE)
        held += [float(command[0])] * per
        for i in range(per):
            u = held[k * per + i]
            slope, bend = rates(vehicle, v, q, u)
            middle, half = v + fine / 2 * slope, q + fine / 2 * bend
            slope, bend = rates(vehicle, middle, half, u)
            p, v, q = p + fine * middle, v + fine * slope, q + fine * bend
            past.append(p)
        past = past[-late - 1 :]
        out.append(p)
    return np.array(out)


def growth(law: AxisLaw, vehicle: LoopVehicle) -> float:
    """Swing of the last ten seconds over that of the ten before."""
    p = flown(law, vehicle, 40.0)
    swing = p[-1000:].reshape(2, 500).std(axis=1)
    return float(swing[1] / swing[0])


LAGGED = (LaggedAxis(3.7, 0.18, 0.05, 0.2, 0.0, 1), LaggedAxis(3.7, 1.2, 0.05, 0.3, 0.1, 2))


@pytest.mark.parametrize("vehicle", LAGGED, ids=["lag", "second_order"])
def test_a_vehicle_with_a_lag_is_unstable_just_above_its_delay_margin(vehicle: LaggedAxis) -> None:
    law = law_for("predictor", 1.5)

    margin = margins(law, vehicle).delay
    assert 0.05 < margin < 1.0
    assert growth(law, vehicle._replace(delay=vehicle.delay + margin - 0.005)) < 1
    assert growth(law, vehicle._replace(delay=vehicle.delay + margin + 0.005)) > 1


@pytest.mark.parametrize("vehicle", LAGGED, ids=["lag", "second_order"])
def test_the_sampled_response_of_a_lag_is_the_sum_of_the_aliases_of_its_continuous_one(vehicle: LaggedAxis) -> None:
    w = np.array([0.3, 2.0, 11.0, 60.0])

    s = 1j * (w + 2 * np.pi / PERIOD * np.arange(-4000, 4001)[:, None])
    held = (1 - np.exp(-s * PERIOD)) / (s * PERIOD)
    structure = structure_named("second_order_zero" if vehicle.order == 2 else "first_order_delay_lag")
    point = Predictor(vehicle.gain, vehicle.damping, vehicle.delay, {"lag": vehicle.lag, "zero": vehicle.zero})
    continuous = velocity_per_command(structure, point, s.imag) / s * np.exp(-s * LATENCY)
    np.testing.assert_allclose(
        vehicle_response(vehicle, PERIOD, LATENCY, w), (continuous * held).sum(axis=0), rtol=1e-6
    )


def test_a_lag_that_vanishes_leaves_the_margins_of_the_first_order_law() -> None:
    law, (g, b, delay) = LAWS["predictor"], VEHICLE

    plain, lagged = margins(law, VEHICLE), margins(law, LaggedAxis(g, b, delay, 1e-5, 0.0, 1))
    assert (lagged.peak, lagged.delay, lagged.phase) == pytest.approx((plain.peak, plain.delay, plain.phase), rel=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_flying_controller_is_stable_just_below_its_delay_margin_and_not_above(kind: Kind) -> None:
    law = LAWS[kind]
    margin = margins(law, VEHICLE).delay

    assert growth(law, VEHICLE._replace(delay=VEHICLE.delay + 0.97 * margin)) < 1
    assert growth(law, VEHICLE._replace(delay=VEHICLE.delay + 1.03 * margin)) > 1


@pytest.mark.parametrize("kind", KINDS)
def test_the_flying_controller_moves_as_the_linear_system_says(kind: Kind) -> None:
    law = LAWS[kind]
    other = AxisBelief(3.2, 0.3, 0.2305)
    M = closed_loop(law, other)
    state = np.zeros(len(M))
    state[0] = 0.1
    p = flown(law, other, 6.0)

    state[2:] = linear_system(law, len(M) - 5)[1] * 0.1  # the law meets its first pose
    followed = []
    for _ in range(301):
        followed.append(state[0])
        state = M @ state
    between = np.interp(PERIOD * np.arange(1, 301), PERIOD * np.arange(301) - LATENCY, followed)
    assert np.abs(between - p)[:-1].max() < 0.002 * np.abs(p).max()


@pytest.mark.parametrize("kind", KINDS)
def test_gain_margins_are_where_an_eigenvalue_leaves_the_unit_circle(kind: Kind) -> None:
    law = LAWS[kind]
    found = margins(law, VEHICLE)

    assert found.stable
    assert spectral_radius(law, VEHICLE._replace(gain=0.999 * found.gain[1] * VEHICLE.gain)) < 1
    assert spectral_radius(law, VEHICLE._replace(gain=1.001 * found.gain[1] * VEHICLE.gain)) > 1


def test_a_margin_below_is_found_where_an_integral_makes_the_loop_conditionally_stable() -> None:
    law = replace(LAWS["linearising"], integral=2.0)
    low, high = margins(law, VEHICLE).gain

    assert 0.1 < low < 1 < high
    assert spectral_radius(law, VEHICLE._replace(gain=1.001 * low * VEHICLE.gain)) < 1
    assert spectral_radius(law, VEHICLE._replace(gain=0.999 * low * VEHICLE.gain)) > 1


@pytest.mark.parametrize("kind", KINDS)
def test_the_delay_margin_is_near_the_phase_margin_over_the_crossover(kind: Kind) -> None:
    found = margins(LAWS[kind], VEHICLE)

    assert found.delay == pytest.approx(found.phase / found.crossover, rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_a_delay_margin_of_seconds_is_found_too(kind: Kind) -> None:
    law = law_for(kind, 0.15)

    margin = margins(law, VEHICLE).delay
    assert 2.5 < margin < 10
    assert spectral_radius(law, VEHICLE._replace(delay=VEHICLE.delay + 0.99 * margin)) < 1
    assert spectral_radius(law, VEHICLE._replace(delay=VEHICLE.delay + 1.01 * margin)) > 1


def test_an_unstable_loop_has_no_margin() -> None:
    found = margins(law_for("predictor", 15.0, VEHICLE._replace(delay=0.0)), VEHICLE)

    assert (found.stable, found.delay, found.phase, found.peak) == (False, 0.0, 0.0, np.inf)


@pytest.mark.filterwarnings("ignore")  # it falls back on sampled frequencies, and says so
@pytest.mark.parametrize("kind", KINDS)
def test_margins_are_those_of_python_control(kind: Kind) -> None:
    control = pytest.importorskip("control")
    vehicle, law = AxisBelief(3.7, 0.18, 0.165), LAWS[kind]  # reach: 9 periods, a delay that python-control can have
    plant = control.ss([[0.0, 1.0], [0.0, -vehicle.damping]], [[0.0], [vehicle.gain]], [[1.0, 0.0]], [[0.0]])
    wait = control.ss(np.eye(9, k=-1), np.eye(9)[:, :1], np.eye(9)[8:], [[0.0]], PERIOD)
    A, B, C = linear_system(law)
    computed = control.ss(A, B[:, None], (C @ A)[None], [[C @ B]], PERIOD)
    loop = -computed * wait * control.c2d(plant, PERIOD, "zoh")

    gain, phase, distance, _, crossover, _ = control.stability_margins(loop)
    found = margins(law, vehicle)

    assert found.gain[1] == pytest.approx(gain, rel=1e-4)
    assert np.degrees(found.phase) == pytest.approx(phase, rel=1e-4)
    assert found.crossover == pytest.approx(crossover, rel=1e-4)
    assert found.peak == pytest.approx(1 / distance, rel=1e-3)


def test_the_response_is_that_of_a_long_sine() -> None:
    law, w = LAWS["predictor"], 2.0
    A, B, C = linear_system(law)
    state, time, out = np.zeros(len(A)), np.arange(6000) * PERIOD, []
    for sample in np.sin(w * time):
        state = A @ state + B * sample
        out.append(float(C @ state))
    parts = np.column_stack([np.sin(w * time), np.cos(w * time), np.ones(time.size)])[
        3000:
    ]  # an integral may rest anywhere
    real, imaginary, _ = np.linalg.lstsq(parts, np.array(out)[3000:], rcond=None)[0]
    assert complex(law_response(law, np.array(w))) == pytest.approx(complex(real, imaginary), rel=1e-6)


def test_a_margin_may_lie_at_the_nyquist_frequency() -> None:
    """At 5 commands a second this loop oscillates from command to command when its gain falls to 0.57."""
    vehicle = AxisBelief(3.7, 0.2, 0.05)
    law = law_of_bandwidth("predictor", vehicle, 4.0, 0.2, 0.015, 0.03)
    low, _ = margins(law, vehicle).gain

    assert low == pytest.approx(0.58, rel=0.01)
    assert spectral_radius(law, vehicle._replace(gain=1.001 * low * vehicle.gain)) < 1
    assert spectral_radius(law, vehicle._replace(gain=0.999 * low * vehicle.gain)) > 1


def test_a_slow_loop_has_the_margins_of_its_crossover() -> None:
    """However far below the Nyquist frequency it lies."""
    slower = VEHICLE._replace(delay=0.6)
    law = law_of_bandwidth("predictor", VEHICLE._replace(delay=0.3), 0.1, PERIOD, LATENCY, 0.06)
    w = np.geomspace(1e-3, 100.0, 20_000)
    L = open_loop(law, slower)(w)
    last = int(np.flatnonzero(np.abs(L) > 1)[-1])
    phase = abs(float(np.angle(-L[last])))

    found, drawn = margins(law, slower), robustness(law, doubt([slower], PERIOD, LATENCY, 0))
    assert found.crossover == pytest.approx(w[last], rel=1e-3)
    assert (found.phase, drawn.phase) == pytest.approx((phase, phase), rel=2e-3)
    assert drawn.delay == pytest.approx(phase / w[last], rel=5e-3)
