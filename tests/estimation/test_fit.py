"""From flights to a model: statuses, intervals, combinations, covariance, the paper's method."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from flights import CARD, by_hand, fit_as_flown, flown, muddled, steps, truth_of
from rotorfit.core.errors import FlightError, ModelError
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import COEFFICIENTS, Axis, Interval
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit, with_delay_profiles
from rotorfit.estimation.methods import METHODS
from rotorfit.files.cards import card_from_mapping
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth

pytestmark = pytest.mark.flights


@cache
def turning() -> tuple[Flight, Fit]:
    flight = flown(Truth(), steps(), 60.0, 21)
    return flight, fit([flight], structure="first_order_delay")


def holds(ends: Interval, value: float) -> bool:
    low, high = ends
    return (low is None or low <= value) and (high is None or value <= high)


def statuses(axis: Axis) -> set[str]:
    return set(axis.status.values())


def has_no_number(axis: Axis) -> bool:
    numbers: list[Mapping[str, object]] = [axis.stderr]
    return (
        (axis.input, axis.damping, axis.delay, axis.predictor) == (None,) * 4
        and all(value is None for mapping in numbers for value in mapping.values())
        and all(ends == (None, None) for ends in axis.ci95.values())
        and not axis.combinations
        and not axis.profile
    )


# What is known


def test_a_flight_that_moves_all_axes_gives_every_coefficient_with_an_interval_around_it() -> None:
    _, result = turning()

    for k, name in enumerate(AXES):
        axis = result.model.axes[name]
        assert statuses(axis) == {"ok"}
        for coefficient, truth in truth_of(Truth(), name).items():
            low, high = axis.ci95[coefficient]
            value = getattr(axis, coefficient)
            assert low is not None
            assert high is not None
            assert low < value < high
            assert abs(value - truth) < 4 * float(axis.stderr[coefficient] or 0)
        assert result.model.gamma[2 * k : 2 * k + 2] == (axis.input, axis.damping)


def test_the_combinations_follow_from_the_point_and_hold_the_truth() -> None:
    _, result = turning()

    for name in AXES:
        axis, truth = result.model.axes[name], truth_of(Truth(), name)
        point = axis.predictor
        assert point is not None
        gain, lag = axis.combinations["steady_gain"], axis.combinations["total_lag"]
        assert gain.value == pytest.approx(point.input / point.damping)
        assert lag.value == pytest.approx(point.delay + 1 / point.damping)
        assert holds(gain.ci95, truth["input"] / truth["damping"])
        assert holds(lag.ci95, truth["delay"] + 1 / truth["damping"])


def test_the_predictor_is_the_published_point_where_that_is_known() -> None:
    _, result = turning()

    for name in AXES:
        axis = result.model.axes[name]
        assert axis.predictor is not None
        assert (axis.input, axis.damping, axis.delay) == tuple(getattr(axis.predictor, c) for c in COEFFICIENTS)


def test_the_noise_levels_are_those_of_the_room() -> None:
    _, result = turning()

    for k, name in enumerate(AXES):
        noise = result.model.axes[name].noise
        assert np.sqrt(noise["pose_variance"]) == pytest.approx(Truth().mocap_noise[k], rel=0.05)


def test_exactly_one_mode_is_chosen_and_it_is_the_first() -> None:
    _, result = turning()

    for name in AXES:
        modes = result.model.axes[name].modes
        assert [mode.chosen for mode in modes] == [True] + [False] * (len(modes) - 1)
        assert max(mode.log_likelihood for mode in modes) == 0.0


# Covariance


def test_the_covariance_is_named_symmetric_positive_definite_and_agrees_with_the_standard_errors() -> None:
    model = turning()[1].model

    assert sorted(model.covariance_names) == sorted(f"{axis}.{name}" for axis in AXES for name in COEFFICIENTS)
    C = model.covariance
    np.testing.assert_allclose(C, C.T, rtol=0, atol=1e-12 * np.abs(C).max())
    size = np.sqrt(np.diag(C))
    assert np.linalg.eigvalsh(C / np.outer(size, size)).min() > 1e-3
    for i, name in enumerate(model.covariance_names):
        axis, coefficient = name.split(".")
        assert model.axes[axis].stderr[coefficient] == pytest.approx(size[i], rel=1e-9)


def test_x_and_y_of_a_turning_vehicle_share_a_block_and_the_others_stand_alone() -> None:
    model = turning()[1].model
    at = {name: i for i, name in enumerate(model.covariance_names)}

    assert model.covariance[at["x.input"], at["y.input"]] != 0.0
    for name in ("x", "yaw"):
        assert model.covariance[at[f"{name}.input"], at["z.input"]] == 0.0


def test_input_and_damping_rise_together_as_their_ratio_is_known_better_than_either() -> None:
    """By the intervals of the flight: the vehicle's spread of each has a prior of its own."""
    model = turning()[1].model
    at = [model.covariance_names.index(f"z.{name}") for name in ("input", "damping")]
    z = model.axes["z"]
    C = model.covariance[np.ix_(at, at)]
    correlation = C[0, 1] / np.sqrt(C[0, 0] * C[1, 1])
    sizes = {"input": z.ci95_flight["input"], "damping": z.ci95_flight["damping"]}
    sizes["ratio"] = z.combinations["steady_gain"].ci95_flight
    share = {name: float(np.log(high / low)) / (2 * 1.96) for name, (low, high) in sizes.items()}  # type: ignore[operator]

    together = share["input"] ** 2 + share["damping"] ** 2 - 2 * correlation * share["input"] * share["damping"]
    assert correlation > 0.4
    assert share["ratio"] < share["damping"]
    assert share["ratio"] == pytest.approx(np.sqrt(together), rel=0.2)


# What is not known


def test_an_axis_that_is_never_commanded_is_not_excited() -> None:
    model = fit_as_flown([flown(Truth(), steps(("z",)), 30.0)]).model

    assert statuses(model.axes["z"]) == {"ok"}
    for name in ("x", "y", "yaw"):
        assert statuses(model.axes[name]) == {"not_excited"}
        assert has_no_number(model.axes[name])
    assert model.gamma[:4] == (None,) * 4
    assert set(model.covariance_names) == {f"z.{name}" for name in COEFFICIENTS}


def test_an_axis_whose_command_explains_nothing_is_not_excited_and_its_noise_is_known() -> None:
    model = fit_as_flown([muddled(flown(Truth(), steps(("z", "yaw"), seed=1), 60.0, 1), "z")]).model

    assert statuses(model.axes["z"]) == {"not_excited"}
    assert has_no_number(model.axes["z"])
    assert np.sqrt(model.axes["z"].noise["pose_variance"]) == pytest.approx(0.0005, rel=0.1)
    assert statuses(model.axes["yaw"]) == {"ok"}


def test_five_seconds_are_too_short() -> None:
    model = fit_as_flown([flown(Truth(), steps(), 5.0)]).model

    for name in AXES:
        assert statuses(model.axes[name]) == {"too_short"}
        assert has_no_number(model.axes[name])
    assert model.covariance.shape == (0, 0)


def test_many_short_flights_are_long_enough_together() -> None:
    flights = [flown(Truth(), steps(("z",), seed=seed), 4.0, seed) for seed in range(4)]

    axis = fit_as_flown(flights, axes=("z",)).model.axes["z"]
    assert axis.status["input"] == "ok"
    assert len(axis.trim) == 4


def test_an_input_whose_interval_excludes_zero_is_excited_however_strong_the_wind() -> None:
    """The contract: an axis is not excited where the interval of its input gain holds 0, and only there."""
    truth = replace(Truth(), wind_sigma=(0.1,) * 4)

    axis = fit_as_flown([flown(truth, steps(("x",), 0.01, seed=1), 100.0, 1)], axes=("x",)).model.axes["x"]
    assert axis.status["input"] == "ok"
    assert holds(axis.ci95["input"], GAMMA_B[0])


def test_of_a_servo_faster_than_its_poses_the_steady_gain_and_the_total_lag_are_known() -> None:
    gamma = (*GAMMA_B[:4], 20.0, 20.0, *GAMMA_B[6:])
    slow = replace(
        Truth(),
        gamma=gamma,
        pose_rate=10.0,
        command_rate=10.0,
        pose_jitter=0.004,
        command_jitter=0.004,
        stale_share=0.0,
        mocap_noise=(0.05,) * 4,
        wind_sigma=(3.0,) * 4,
    )
    open_ends = 0
    for seed in (1, 2):
        axis = fit_as_flown([flown(slow, steps(("z",), 0.4, seed=seed), 50.0, seed)], axes=("z",)).model.axes["z"]
        assert axis.status["damping"] == "not_identifiable"
        assert axis.damping is None
        assert axis.stderr["damping"] is None
        assert axis.predictor is not None
        gain, lag = axis.combinations["steady_gain"], axis.combinations["total_lag"]
        open_ends += None in (*gain.ci95, *lag.ci95)
        assert holds(gain.ci95, 1.0)
        assert holds(lag.ci95, 0.15 + 1 / 20)
        assert holds(axis.ci95["damping"], 20.0)
        assert holds(axis.ci95["input"], 20.0)
    assert open_ends <= 1  # they are hardly known: rounding may decide that a climb ends where nothing more is told


def test_a_coefficient_that_is_not_identifiable_is_null_and_keeps_its_interval() -> None:
    """Two slow sines of half the paper's amplitude on z hardly tell delay from damping."""
    flight = flown(Truth(), partial(two_sines, axes=("z",), amplitude=0.5), 60.0, 3)
    axis = fit_as_flown([flight], axes=("z",)).model.axes["z"]

    unknown = [name for name in COEFFICIENTS if axis.status[name] == "not_identifiable"]
    assert "damping" in unknown
    for name in unknown:
        assert getattr(axis, name) is None
        assert axis.stderr[name] is None
        assert axis.ci95[name] != (None, None)
    for name, truth in truth_of(Truth(), "z").items():
        assert holds(axis.ci95[name], truth)


def test_no_delay_is_a_number_like_another() -> None:
    truth = replace(Truth(), delay=(0.0,) * 4)

    model = fit([flown(truth, steps(), 25.0)], structure="first_order_delay").model
    for name in AXES:
        axis = model.axes[name]
        assert statuses(axis) == {"ok"}
        assert axis.delay == pytest.approx(0.0, abs=0.003)
        assert holds(axis.ci95["delay"], 0.0)


def later(flight: Flight, shift: float) -> Flight:
    """Commands stamped later than they were sent."""
    return replace(
        flight,
        command_time=flight.command_time + shift,
        segments=tuple(Segment(part.start + shift, part.end) for part in flight.segments),
    )


def test_commands_that_are_stamped_late_give_a_negative_delay() -> None:
    flight = flown(replace(Truth(), delay=(0.0,) * 4), steps(), 25.0)

    model = fit([later(flight, 0.05)], structure="first_order_delay").model
    for name in AXES:
        assert model.axes[name].delay == pytest.approx(-0.05, abs=0.003)
        assert holds(model.axes[name].ci95["delay"], -0.05)


def test_a_card_with_the_wrong_sign_is_fitted_and_told_even_where_the_delay_is_nothing() -> None:
    """Noise makes the estimate of no delay a hair negative: that and the sign are no feedback loop read backwards."""
    flight = flown(replace(Truth(), delay=(0.0,) * 4), steps(), 25.0)

    model = fit([replace(flight, command=-flight.command)], structure="first_order_delay").model
    for name in AXES:
        assert statuses(model.axes[name]) == {"ok"}
        assert model.axes[name].input == pytest.approx(-truth_of(Truth(), name)["input"], rel=0.05)


# Several flights


def test_trims_belong_to_flights_and_are_none_where_a_flight_does_not_serve_the_axis() -> None:
    trims = (0.05, -0.08)
    flights = [
        flown(replace(Truth(), trim=(0.0, 0.0, trim, 0.0)), steps(("z",), seed=seed), 30.0, seed)
        for seed, trim in enumerate(trims)
    ]
    yaw = flown(Truth(), steps(("yaw",)), 30.0, 9)

    found = fit_as_flown([flights[0], yaw, flights[1]], axes=("z", "yaw")).model.axes["z"].trim
    assert found[1] is None
    np.testing.assert_allclose([found[0], found[2]], trims, atol=0.02)


def test_only_the_wanted_axes_are_fitted() -> None:
    flight, result = turning()

    model = fit([flight], axes=("y",), structure="first_order_delay").model
    for name in ("x", "z", "yaw"):
        assert has_no_number(model.axes[name])
    assert model.axes["y"].input == pytest.approx(result.model.axes["y"].input, rel=0.02)
    whole = list(result.model.covariance_names)
    own = [whole.index(f"y.{name}") for name in COEFFICIENTS]
    assert list(model.covariance_names) == [f"y.{name}" for name in COEFFICIENTS]  # fitted together with x
    np.testing.assert_allclose(model.covariance, result.model.covariance[np.ix_(own, own)], rtol=0.02)


def test_no_flight_and_flights_of_different_cards_are_refused_in_one_line() -> None:
    with pytest.raises(FlightError, match="no flight"):
        fit([])

    flight = flown(Truth(), steps(("z",)), 10.0)
    other = card_from_mapping({**CARD.raw, "name": "another"}, "here")
    with pytest.raises(FlightError, match="different cards") as refused:
        fit([flight, replace(flight, card=other)])
    assert "\n" not in str(refused.value)


def test_progress_is_told_from_nothing_to_all_and_raising_in_it_cancels() -> None:
    flight = flown(Truth(), steps(("z", "yaw")), 15.0)
    told: list[tuple[float, str]] = []

    fit([flight], progress=lambda fraction, text: told.append((fraction, text)))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0

    def cancel(_fraction: float, _text: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit([flight], progress=cancel)


# The profile


def test_the_drawn_profile_covers_the_searched_delays_and_nothing_in_it_is_above_the_top() -> None:
    flight = flown(Truth(), steps(("z",)), 20.0)

    short = fit([flight], axes=("z",), structure="first_order_delay")
    drawn = with_delay_profiles(short).model.axes["z"]
    delays = [delay for delay, _ in drawn.profile]
    assert delays == sorted(delays)
    assert delays[0] == DELAY_RANGE[0]
    assert delays[-1] == DELAY_RANGE[1]
    assert max(value for _, value in drawn.profile) < 0.1
    assert len(short.model.axes["z"].profile) < len(drawn.profile)
    assert replace(drawn, profile=()) == replace(short.model.axes["z"], profile=())


# The paper's method


@cache
def slow_drone() -> Flight:
    truth = replace(Truth(), gamma=(GAMMA_B[0], 0.05, *GAMMA_B[2:]), delay=(0.2,) * 4)
    return flown(truth, partial(two_sines, axes=("x",)), 60.0, 1)


def test_the_profile_of_a_long_flight_is_that_of_the_whole_where_a_delay_is_possible(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Elsewhere it is that of stretches: as impossible."""
    truth = replace(Truth(), pose_rate=30.0)
    long = fit(
        [flown(truth, steps(("z",), 0.01, seed=3, every=1.5), 420.0, 3)], axes=("z",), structure="first_order_delay"
    )

    quick = dict(with_delay_profiles(long).model.axes["z"].profile)
    monkeypatch.setattr("rotorfit.estimation.fitting.on_stretches", lambda *_: None)
    whole = dict(with_delay_profiles(long).model.axes["z"].profile)

    possible = [delay for delay, height in whole.items() if height > -25]
    assert quick.keys() == whole.keys()
    assert 0 < len(possible) < len(whole)
    assert [quick[delay] for delay in possible] == pytest.approx([whole[delay] for delay in possible], abs=0.1)
    assert max(height for delay, height in quick.items() if delay not in possible) < -25


def test_by_the_papers_method_a_delay_makes_a_small_damping_negative_and_by_the_likelihood_it_does_not() -> None:
    paper, ml = (fit([slow_drone()], method=method, axes=("x",)).model for method in ("paper", "ml"))

    assert paper.method == "paper"
    assert paper.gamma[1] is not None
    assert paper.gamma[1] < 0
    assert paper.axes["x"].status == {"input": "ok", "damping": "ok", "delay": "not_identifiable"}
    assert paper.paper == ml.paper
    assert ml.paper[1] == paper.gamma[1]
    point = ml.axes["x"].predictor
    assert point is not None
    assert point.damping > 0
    assert point.delay == pytest.approx(0.2, abs=0.02)


def test_a_method_that_is_not_in_the_table_is_refused_with_the_names_of_those_that_are() -> None:
    with pytest.raises(ModelError, match=f"no such method: 'arx'; methods are {', '.join(METHODS)}"):
        fit([slow_drone()], method="arx")


def test_a_model_by_the_papers_method_can_predict_simulate_and_has_a_covariance() -> None:
    model = fit([slow_drone()], method="paper", axes=("x",)).model
    axis = model.axes["x"]

    assert axis.predictor is not None
    assert axis.predictor.delay == 0.0
    assert model.covariance_names == ("x.input", "x.damping")
    np.testing.assert_allclose(
        np.sqrt(np.diag(model.covariance)), [axis.stderr["input"], axis.stderr["damping"]], rtol=1e-9
    )
    assert set(axis.noise) == {"wind_power", "pose_variance", "wind_damping", "wind_overlap", "trim_variance"}


def test_a_pose_that_only_drifts_tells_nothing_of_an_axis_that_is_commanded_a_constant() -> None:
    t = np.arange(0, 20, 0.01)
    pose = 1e-4 * np.random.default_rng(0).standard_normal((t.size, 4)).cumsum(axis=0)
    command = np.full((1000, 4), 0.1)

    model = fit_as_flown([by_hand(t, pose, t[::2], command)]).model
    for name in AXES:
        assert model.axes[name].status["input"] != "ok"


def test_a_flight_that_only_holds_an_axis_does_not_serve_it_and_says_so() -> None:
    moving = by_hand_held(1.0)
    holding = by_hand_held(0.05)
    fitted = fit_as_flown([moving, holding])

    assert [source.axes for source in fitted.model.flights] == [("x",), ()]
    assert [note.code for note in fitted.model.flights[1].notes][-1] == "held_axis"
    assert fitted.model.axes["x"].input == pytest.approx(fit_as_flown([moving]).model.axes["x"].input, rel=1e-12)


def by_hand_held(share: float) -> Flight:
    """A flight on x whose steps are a share of those of another."""
    flight = flown(Truth(), steps(("x",), 0.2 * share, seed=3), 20.0, seed=3)
    return replace(flight, axes=("x",))


# Long flights: the optima are searched in a part


def gated(begin: float, end: float, factor: float = 0.0) -> Callable[[Array], Array]:
    """Steps of z; outside of an interval [s] multiplied by a factor."""
    excitation = steps(("z",), seed=2)

    def commands(t: Array) -> Array:
        inside = (t >= begin) & (t < end)
        return np.asarray(excitation(t) * np.where(inside, 1.0, factor)[:, None])

    return commands


def test_excitation_at_the_very_end_of_a_long_flight_is_found() -> None:
    late = flown(Truth(), gated(100.5, 108.0), 108.0, 3)

    axis = fit([late], axes=("z",), structure="first_order_delay").model.axes["z"]
    assert statuses(axis) == {"ok"}
    assert holds(axis.ci95["input"], truth_of(Truth(), "z")["input"])


def test_commands_whose_response_no_pose_shows_do_not_count() -> None:
    whole = flown(Truth(), gated(100.0, 170.0, 0.5), 200.0, 4)
    seen = (whole.pose_time < 100.0) | (whole.pose_time > 170.0)
    blind = replace(
        whole, pose_time=whole.pose_time[seen], position=whole.position[seen], yaw=whole.yaw[seen], velocity=None
    )

    axis = fit([blind], axes=("z",), structure="first_order_delay").model.axes["z"]
    assert statuses(axis) == {"ok"}
    assert holds(axis.ci95["input"], truth_of(Truth(), "z")["input"])


def test_a_flight_of_a_few_samples_beside_another_spoils_nothing() -> None:
    long, short = flown(Truth(), steps(("z",), seed=2), 40.0, 5), flown(Truth(), steps(("z",), seed=3), 10.0, 6)
    brief = replace(short, segments=(Segment(short.segments[0].start, short.segments[0].start + 0.8),))

    axis = fit([long, brief], axes=("z",)).model.axes["z"]
    assert axis.status["input"] == "ok"


def test_time_between_segments_is_no_data() -> None:
    whole = flown(Truth(), steps(("z",), seed=2), 60.0, 5)
    pieces = tuple(Segment(start, start + 0.95) for start in (2.0, 14.0, 26.0, 38.0, 50.0))

    axis = fit([replace(whole, segments=pieces)], axes=("z",)).model.axes["z"]
    assert statuses(axis) == {"too_short"}


# Delays beyond the range that is searched


@pytest.mark.parametrize("method", ["ml", "iv", "oe"])
def test_with_the_delay_at_the_end_of_its_range_nothing_is_published(method: str) -> None:
    flight = flown(Truth(), steps(("z",), seed=2), 40.0, 5)
    late = replace(flight, command_time=flight.command_time - 0.7)

    axis = fit([late], method, axes=("z",)).model.axes["z"]
    assert statuses(axis) <= {"not_identifiable", "not_excited"}
    assert axis.input is None
    assert all(value is None for value in axis.extra.values())
