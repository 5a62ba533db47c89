"""Optimal designs: against another solver, a bound on every design, the simulator, and the laws they must obey."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import minimize

from flights import recorded
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Feedback, Steps, value
from rotorfit.core.frames import Array
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.likelihood import inverted, score
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.planning.axis_information import (
    AxisBelief,
    AxisInformation,
    against_feedback,
    axis_information,
    extremes,
    motion_at,
    transitions,
)
from rotorfit.planning.optimal import TARGETS, AxisLimits, OptimalSignal, optimal_signal
from rotorfit.planning.signals import paper_sines
from rotorfit.simulation.paper_vehicle import Controller, Truth, noise_free, simulate_flight

pytestmark = pytest.mark.flights

TRUTH = Truth(pose_jitter=0.0, command_jitter=0.0, stale_share=0.0)
X = AxisBelief(TRUTH.gamma[0], TRUTH.gamma[1], TRUTH.delay[0])
Z = AxisBelief(TRUTH.gamma[4], TRUTH.gamma[5], TRUTH.delay[2])
ROOM = AxisLimits(command=0.4, lower=-1.0, upper=1.0, speed=1.2)
DURATION, STEP = 10.0, 0.2


def levels_of(damping: float) -> Array:
    """Disturbance levels of the simulator's wind and mocap at a damping."""
    power, rate = 2 * TRUTH.wind_sigma[0] ** 2, 1 / TRUTH.wind_time[0]
    poles = damping + rate
    return np.log([power * rate, TRUTH.mocap_noise[0] ** 2, poles, 4 * damping * rate / poles**2])


@cache
def design(criterion: str = "d", dynamics: AxisBelief = X, limits: AxisLimits = ROOM, seed: int = 0) -> OptimalSignal:
    return optimal_signal(
        dynamics,
        levels_of(dynamics.damping),
        limits,
        DURATION,
        criterion,
        seed,
        step=STEP,  # type: ignore[arg-type]
    )


@cache
def form(dynamics: AxisBelief = X) -> AxisInformation:
    return axis_information(dynamics, levels_of(dynamics.damping), DURATION, STEP)


def commands(signal: Steps, count: int = round(DURATION / STEP), step: float = STEP) -> Array:
    return value(signal, step * np.arange(count))


def score_d(command: Array, dynamics: AxisBelief = X) -> float:
    scaled = form(dynamics).information(command) * np.outer(TARGETS, TARGETS)
    return float(np.linalg.slogdet(scaled)[1]) / 6


def reach(command: Array, limits: AxisLimits, dynamics: AxisBelief = X, step: float = STEP) -> float:
    """How much of its limits a command uses; above 1 it leaves them."""
    low, high, speed = extremes(dynamics, command, step)
    return max(
        float(np.abs(command).max()) / limits.command, low / limits.lower, high / limits.upper, speed / limits.speed
    )


# The information


def test_the_information_of_levels_is_that_of_the_commands_they_make() -> None:
    window, level = np.array([0.2, 0.5, 0.3]), np.sin(np.arange(48.0))
    smooth = axis_information(X, levels_of(X.damping), DURATION, STEP, window=window)
    np.testing.assert_allclose(smooth.information(level), form().information(np.convolve(level, window)), rtol=1e-8)


def test_the_information_of_longer_levels_is_that_of_repeated_ones() -> None:
    level = np.sin(np.arange(25.0))
    np.testing.assert_allclose(form().held(2).information(level), form().information(np.repeat(level, 2)), rtol=1e-9)


def test_the_information_is_that_of_the_likelihood_on_the_flight_itself() -> None:
    signal = design(dynamics=Z).signal
    flight = simulate_flight(noise_free(TRUTH), lambda t: np.outer(value(signal, t), [0, 0, 1, 0]), DURATION + 0.02, 0)
    rec = record(recorded(flight), ("z",))
    assert rec is not None
    point = Point(
        np.array([Z.gain]), np.log([Z.damping]), np.array([Z.delay]), np.zeros((1, 1)),
        np.interp(rec.starts[:, None], flight.pose_stamp * 1e-9, flight.velocity[:, 2]), levels_of(Z.damping)[None],
    )  # fmt: skip

    covariance = inverted(score([rec], point).information[: point.n, : point.n], np.ones(point.n, bool))

    told = np.sqrt(np.diag(covariance))[:3] / [Z.gain, 1, 1]
    np.testing.assert_allclose(form(Z).errors(commands(signal)), told, rtol=0.01)


def test_errors_fall_as_the_command_grows_and_know_no_sign() -> None:
    command = commands(design().signal)

    np.testing.assert_allclose(form().errors(-3 * command), form().errors(command) / 3, rtol=1e-9)


# The optimum


def test_a_general_solver_from_many_starts_finds_nothing_better() -> None:
    best = design()
    N, rng = round(DURATION / STEP), np.random.default_rng(1)
    position, speed = motion_maps(X, N)
    rows = np.concatenate([position, speed[:-1]])
    room = np.concatenate([np.full(N, ROOM.upper), np.full(N - 1, ROOM.speed)])
    inside = [
        {"type": "ineq", "fun": lambda u: np.concatenate([room - rows @ u, room + rows @ u]),
         "jac": lambda _: np.concatenate([-rows, rows])},
        {"type": "eq", "fun": lambda u: np.array([position[-1] @ u, speed[-1] @ u]),
         "jac": lambda _: np.array([position[-1], speed[-1]])},
    ]  # fmt: skip

    def slope(u: Array) -> Array:
        products = form().products(u)
        return np.asarray(-np.einsum("ij,ijk->k", np.linalg.inv(products @ u), products) / 3)

    found = [
        minimize(
            lambda u: -score_d(u),
            0.1 * rng.standard_normal(N),
            jac=slope,
            method="SLSQP",
            constraints=inside,
            bounds=[(-ROOM.command, ROOM.command)] * N,
            options={"maxiter": 60},
        )
        for _ in range(5)
    ]

    valid = [-each.fun for each in found if reach(each.x, ROOM) < 1.02]
    assert len(valid) > 2
    assert max(valid) < best.score + 0.01


def motion_maps(dynamics: AxisBelief, count: int) -> tuple[Array, Array]:
    """Positions and speeds after each step, by the commands: twice (N, N)."""
    f, k, h = transitions(dynamics.damping, np.array(STEP))
    position, speed = np.zeros((count + 1, count)), np.zeros((count + 1, count))
    for i, pulse in enumerate(dynamics.gain * np.eye(count)):
        position[i + 1] = position[i] + k * speed[i] + h * pulse
        speed[i + 1] = f * speed[i] + k * pulse
    return position[1:], speed[1:]


def test_no_command_at_all_can_be_much_better() -> None:
    """Relaxed to mean squares, the problem has a dual, any point of which bounds every design from above."""
    count, dynamics = round(DURATION / STEP), Z
    position, speed = motion_maps(dynamics, count)
    use = np.array(
        [
            np.eye(count) / ROOM.command**2,
            position.T @ position / ROOM.upper**2,
            speed.T @ speed / ROOM.speed**2,
        ]
    )
    scaled = form(dynamics).form * np.outer(TARGETS, TARGETS)[:, :, None, None]
    lower = np.tril_indices(3)

    def bound(x: Array) -> float:
        share, root = np.exp(x[:3]), np.zeros((3, 3))
        root[lower] = x[3:]
        root[np.diag_indices(3)] = np.exp(np.diag(root))
        limit = np.tensordot(share / share.sum(), use, 1) / count
        form_of_weight = np.tensordot(root @ root.T, scaled, 2)
        largest = eigh(form_of_weight, limit, eigvals_only=True, subset_by_index=[count - 1] * 2)[0]
        return float(3 * np.log(largest / 3) - 2 * np.log(np.diag(root)).sum()) / 6

    best = design(dynamics=dynamics)
    weight = np.linalg.cholesky(np.linalg.inv(np.tensordot(scaled @ commands(best.signal), commands(best.signal), 1)))
    weight[np.diag_indices(3)] = np.log(np.diag(weight))
    x = np.concatenate([np.zeros(3), weight[lower]])
    for size in (1.5, 0.3):
        simplex = np.concatenate([x[None], x + size * np.eye(9)])
        x = minimize(bound, x, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": 600}).x

    assert best.score < bound(x) < best.score + np.log(1.25)


@pytest.mark.parametrize("criterion", ["d", "a"])
def test_the_climb_never_falls_and_ends_where_nothing_is_left_to_first_order(criterion: str) -> None:
    best = design(criterion)

    assert all(later >= earlier for earlier, later in pairwise(best.history))
    assert best.gap < 1e-4
    assert best.score == pytest.approx(max(best.scores), abs=0.01)


def test_each_criterion_is_best_at_its_own() -> None:
    def mean_square(best: OptimalSignal) -> float:
        return float(np.mean((np.array(best.errors) / TARGETS) ** 2))

    d, a = design("d"), design("a")

    assert mean_square(a) < mean_square(d)
    assert score_d(commands(a.signal)) < d.score
    assert a.score == pytest.approx(-0.5 * np.log(mean_square(a)), rel=1e-9)


def test_the_two_sines_scaled_to_the_same_limits_tell_less() -> None:
    t = STEP * np.arange(round(DURATION / STEP))
    sines = value(paper_sines("x"), t)

    assert score_d(sines / reach(sines, ROOM)) < design().score - np.log(1.5)


# Limits


@pytest.mark.parametrize(
    "limits",
    [ROOM, AxisLimits(0.4, -0.4, 1.5, 0.8), AxisLimits(1.0, -0.5, 0.5, np.inf), AxisLimits(0.05, -9.0, 9.0, 9.0)],
)
def test_the_simulated_vehicle_stays_inside_and_comes_to_rest_where_it_began(limits: AxisLimits) -> None:
    signal = design(limits=limits).signal
    still = noise_free(TRUTH)

    flight = simulate_flight(still, lambda t: np.outer(value(signal, t), [1, 0, 0, 0]), DURATION + 1, 0)

    path, speed = flight.true_pose[:, 0], flight.velocity[:, 0]
    assert np.abs(flight.command[:, 0]).max() <= limits.command
    assert limits.lower - 1e-6 <= path.min()
    assert path.max() <= limits.upper + 1e-6
    assert np.abs(speed).max() <= limits.speed + 1e-6
    assert abs(path[-1]) < 1e-3
    assert abs(speed[-1]) < 1e-3


def test_a_window_keeps_out_what_is_fast_and_all_limits() -> None:
    """Behind a Hann window of width W the spectrum beyond two times 2 pi / W is nearly gone; hard steps have it."""
    hard, width, step = design(), 2.0, 0.1
    soft = optimal_signal(X, levels_of(X.damping), ROOM, DURATION, step=step, smooth=width)

    command = commands(soft.signal, 100, step)
    assert fast_share(command, step, 4 * np.pi / width) < 0.002
    assert fast_share(commands(hard.signal), STEP, 4 * np.pi / width) > 0.05
    assert np.abs(np.diff(command)).max() <= 2 * ROOM.command * 2 * step / width
    assert reach(command, ROOM, step=step) <= 1 + 1e-9
    assert soft.score < hard.score


def fast_share(command: Array, step: float, above: float) -> float:
    """Share of a command's power beyond a frequency [rad/s]; Hann's taper keeps its ends out of it."""
    power = np.abs(np.fft.rfft(command * np.hanning(command.size), 8 * command.size)) ** 2
    return float(power[2 * np.pi * np.fft.rfftfreq(8 * command.size, step) > above].sum() / power.sum())


def test_extremes_between_the_steps_are_seen() -> None:
    flight = simulate_flight(
        noise_free(TRUTH), lambda t: np.outer(value(Steps((0.0, 0.5, 1.5), (0.4, -0.4, 0.3)), t), [1, 0, 0, 0]), 2.65, 0
    )

    low, high, speed = extremes(X, np.repeat([0.4, -0.4, 0.3], [1, 2, 2]), 0.5)

    assert low == pytest.approx(flight.true_pose[:, 0].min(), abs=1e-4)
    assert high == pytest.approx(flight.true_pose[:, 0].max(), abs=1e-4)
    assert speed == pytest.approx(np.abs(flight.velocity[:, 0]).max(), abs=2e-2)


def test_the_motion_of_a_signal_is_that_of_the_simulator() -> None:
    signal = design().signal
    flight = simulate_flight(noise_free(TRUTH), lambda t: np.outer(value(signal, t), [1, 0, 0, 0]), DURATION + 0.5, 0)

    position, velocity = motion_at(X, signal, flight.pose_stamp * 1e-9)

    np.testing.assert_allclose(position, flight.true_pose[:, 0], atol=1e-5)
    np.testing.assert_allclose(velocity, flight.velocity[:, 0], atol=1e-5)


def test_against_a_feedback_the_same_motion_is_flown_and_the_wind_does_not_carry_it_away() -> None:
    feedback = Feedback(("x",), (0.3,) * 4, (0.5,) * 4)
    signal = design().signal
    raised = against_feedback(signal, "x", X, feedback, DURATION, 0.1)

    def path_of(truth: Truth, signal: Steps, seed: int, held: bool) -> Array:
        controller = Controller(feedback.stiffness, feedback.damping, feedback.filter_time, ("x",)) if held else None
        flight = simulate_flight(
            truth, lambda t: np.outer(value(signal, t), [1, 0, 0, 0]), DURATION, seed, controller=controller
        )
        return flight.true_pose[:, 0]

    free = path_of(noise_free(TRUTH), signal, 0, False)
    assert np.ptp(free) > 1.0
    assert np.abs(path_of(noise_free(TRUTH), raised, 0, True) - free).max() < 0.02
    assert np.abs(path_of(noise_free(TRUTH), signal, 0, True) - free).max() > 0.2

    blown, kept = (
        np.mean([np.square(path_of(TRUTH, each, seed, held) - free) for seed in range(1, 9)])
        for each, held in ((signal, False), (raised, True))
    )
    assert kept < blown / 9


# Laws


def test_the_same_seed_gives_the_same_signal_and_another_seed_another() -> None:
    again = optimal_signal(X, levels_of(X.damping), ROOM, DURATION, step=STEP)

    assert again == design()
    assert design(seed=1).signal != again.signal
    assert design(seed=1).score == pytest.approx(again.score, abs=0.03)


def test_a_mirrored_room_is_as_good() -> None:
    one, other = (design(limits=AxisLimits(0.4, low, high, 1.2)) for low, high in ((-0.4, 1.2), (-1.2, 0.4)))

    assert one.score == pytest.approx(other.score, abs=0.04)
    assert reach(-commands(one.signal), AxisLimits(0.4, -1.2, 0.4, 1.2)) <= 1 + 1e-9


def test_twice_the_limits_halve_the_errors() -> None:
    twice = design(limits=AxisLimits(0.8, -2.0, 2.0, 2.4))

    assert twice.score == pytest.approx(design().score + np.log(2), abs=0.01)


def test_a_stronger_input_with_smaller_commands_is_the_same_flight() -> None:
    strong = design(dynamics=X._replace(gain=2 * X.gain), limits=AxisLimits(0.2, -1.0, 1.0, 1.2))

    assert strong.score == pytest.approx(design().score, abs=0.01)


def test_a_long_flight_is_equal_pieces_that_join_at_rest() -> None:
    long = optimal_signal(Z, levels_of(Z.damping), ROOM, 80.0, step=1.0)
    command = commands(long.signal, 80, 1.0)

    assert long.pieces == 2
    np.testing.assert_array_equal(command[:40], command[40:])
    assert reach(command, ROOM, Z, 1.0) <= 1 + 1e-6


# Errors


@pytest.mark.parametrize(
    ("limits", "dynamics", "duration", "said"),
    [
        (AxisLimits(0.4, 0.0, 1.0, 1.0), X, DURATION, "no room to fly"),
        (AxisLimits(0.4, -1.0, 1.0, 0.0), X, DURATION, "no room to fly"),
        (ROOM, X._replace(damping=-0.1), DURATION, "positive damping"),
        (ROOM, X, 1.0, "too short"),
    ],
)
def test_what_cannot_be_designed_is_refused(
    limits: AxisLimits, dynamics: AxisBelief, duration: float, said: str
) -> None:
    with pytest.raises(PlanError, match=said):
        optimal_signal(dynamics, levels_of(0.2), limits, duration)


def test_progress_is_told_and_cancels() -> None:
    shares = []

    def stop(share: float, _: str) -> None:
        shares.append(share)
        if share > 0.1:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        optimal_signal(X, levels_of(X.damping), ROOM, DURATION, progress=stop, step=STEP)
    assert shares == sorted(shares)
