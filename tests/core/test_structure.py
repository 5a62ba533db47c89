"""Every structure gives back the truth that another integrator flew, and the default where it adds nothing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flights import flown, steps
from other_laws import DELAY, LAG, TRUTH, B, G, flown_by
from rotorfit.assessment.innovations import residuals
from rotorfit.assessment.validation import validate
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import Array
from rotorfit.core.laws import FIRST_ORDER_DELAY, START_LEVELS, STRUCTURES, structure_named
from rotorfit.core.model import STRUCTURE, Axis, Model
from rotorfit.dynamics.trajectory import simulate, state_space
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.likelihood import restriction, score
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.simulation.paper_vehicle import Truth

pytestmark = pytest.mark.flights

NEUTRAL = {"lag": 1e-3, "drag_share": 0.0, "reference_speed": 0.5, "level": 1e3, "acceleration_limit": 90.0}
"""Where a further parameter does nothing; 0 for all others."""


def published(axis: Axis, name: str) -> float | None:
    if name in axis.combinations:
        return axis.combinations[name].value
    return axis.extra[name] if name in axis.extra else getattr(axis, name)  # type: ignore[no-any-return]


def inside(axis: Axis, name: str, value: float) -> bool:
    low, high = axis.combinations[name].ci95 if name in axis.combinations else axis.ci95[name]
    return (low is None or low <= value) and (high is None or value <= high)


def point_of(K: int, name: str = "", **values: float) -> Point:
    structure = structure_named(name or "first_order_delay")
    extra = np.array([[e.coordinate(values.get(e.name, NEUTRAL.get(e.name, 0.0)))] * K for e in structure.extras])
    return Point(
        gain=np.array([3.7, 2.9])[:K],
        log_damping=np.log([0.5, 0.9])[:K],
        delay=np.array([0.15, 0.11])[:K],
        trim=np.array([[0.05, -0.1]])[:, :K],
        start=np.array([[0.3, -0.2]])[:, :K],
        levels=np.tile(START_LEVELS, (K, 1)),
        structures=(structure,) * K if name else (),
        extra=extra.reshape(len(structure.extras), K),
    )


@pytest.fixture(scope="module")
def turning() -> tuple[Array, Array]:
    """Records of z alone and of x with y while the vehicle turns."""
    flight = flown(Truth(), steps(seed=3), 20.0, 5)
    return record(flight, ("z",)), record(flight, ("x", "y"))  # type: ignore[return-value]


@pytest.mark.parametrize("name", [name for name in STRUCTURES if STRUCTURES[name].extras])
def test_where_it_adds_nothing_a_structure_moves_as_the_default_does(name: str, turning: tuple[Array, Array]) -> None:
    for K, rec in enumerate(turning, 1):
        if name == "coupled" and K == 1:
            continue
        plain, other = point_of(K), point_of(K, name)
        lag = 1e-3 if "lag" in {e.name for e in STRUCTURES[name].extras} else 0.0
        other = replace(other, delay=other.delay - lag)
        mean, columns = response(rec, plain, 0, plain.start)  # type: ignore[arg-type]
        found, more = response(rec, other, 0, other.start)  # type: ignore[arg-type]

        E = len(STRUCTURES[name].extras)
        kept = np.r_[: 3 * K, (3 + E) * K : (5 + E) * K]
        first = (
            STRUCTURES[name].order == 2 or STRUCTURES[name].world
        )  # turns by another angle: of first order in the lag
        near = 2 * lag if first else 20 * lag**2
        np.testing.assert_allclose(found, mean, rtol=0, atol=near + 1e-9)
        np.testing.assert_allclose(more[:, kept], columns, rtol=0, atol=(5 * lag + 1e-9) * np.abs(columns).max())


@pytest.mark.parametrize("name", [name for name in STRUCTURES if STRUCTURES[name].extras])
def test_sensitivities_are_the_slopes_of_the_motion(name: str, turning: tuple[Array, Array]) -> None:
    values = {"lag": 0.1, "drag_share": 0.4, "reference_speed": 0.6, "asymmetry": 0.2, "level": 0.15}
    values |= {"acceleration_limit": 0.4, "dead_zone": 0.03, "zero": 0.25, "cross_input": 0.5, "cross_damping": 0.2}
    for K, rec in enumerate(turning, 1):
        if name == "coupled" and K == 1:
            continue
        point, step = point_of(K, name, **values), 1e-5
        columns = response(rec, point, 0, point.start)[1]  # type: ignore[arg-type]
        flat, fixed = point.flat(), [e for e, one in enumerate(STRUCTURES[name].extras) if not one.estimated]
        for i in (i for i in range(columns.shape[1]) if (i // K - 3) not in fixed):
            ends = []
            for side in (-step, step):
                moved = flat.copy()
                moved[i] += side
                there = point.with_flat(moved)
                ends.append(response(rec, there, 0, there.start)[0])  # type: ignore[arg-type]
            slope = (ends[1] - ends[0]) / (2 * step)
            np.testing.assert_allclose(columns[:, i], slope, rtol=0, atol=2e-3 * np.abs(slope).max())


def test_the_score_of_a_structure_is_the_slope_of_its_likelihood() -> None:
    rec = record(flown_by("first_order_delay_lag", duration=20.0, wind=0.1, noise=0.001), ("z",))
    assert rec is not None
    point = replace(point_of(1, "first_order_delay_lag", lag=0.1), start=np.zeros((1, 1)))
    limits = restriction([rec], point, np.ones(point.flat().size, bool))
    gradient, flat = score([rec], point, limits).gradient, point.flat()
    for i in range(flat.size):
        ends = []
        for side in (-1e-5, 1e-5):
            moved = flat.copy()
            moved[i] += side
            ends.append(score([rec], point.with_flat(moved), limits).objective)
        assert gradient[i] == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=2e-3, abs=0.05), i


@cache
def without_noise(name: str) -> Model:
    """z of a vehicle of this law as it is fitted by it."""
    return fit([flown_by(name)], axes=("z",), structure=name).model


@pytest.mark.parametrize("name", [name for name in TRUTH if name != "coupled"])
def test_without_noise_every_structure_gives_back_its_truth(name: str) -> None:
    axis = without_noise(name).axes["z"]

    assert axis.structure == name
    for parameter, value in TRUTH[name].items():
        assert published(axis, parameter) == pytest.approx(value, rel=2e-3), parameter


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_coupling_of_x_and_y_comes_back_whether_the_vehicle_turns_or_not(turn: float) -> None:
    model = fit([flown_by("coupled", ("x", "y"), turn=turn)], axes=("x", "y"), structure="coupled").model

    for parameter, value in TRUTH["coupled"].items():
        assert published(model.axes["x"], parameter) == pytest.approx(value, rel=5e-3), parameter
    assert model.axes["y"].extra == pytest.approx({"cross_input": -0.4, "cross_damping": -0.2}, rel=5e-3)


DEFAULT = ("first_order_delay", "first_order_delay_lag", "second_order_zero")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in DEFAULT else pytest.mark.slow) for name in TRUTH if name != "coupled"],
)
def test_in_wind_and_noise_the_intervals_hold_the_truth(name: str) -> None:
    wind = 0.05 if name == "limited_acceleration" else 0.1  # stronger gusts reach the limit: it is left out
    flight = flown_by(name, duration=60.0, seed=4, wind=wind, noise=0.001)
    axis = fit([flight], axes=("z",), structure=name).model.axes["z"]

    assert axis.structure == name
    missed = [parameter for parameter, value in TRUTH[name].items() if not inside(axis, parameter, value)]
    assert missed == []
    assert all(axis.status[parameter] == "ok" for parameter in TRUTH[name] if parameter in axis.status)


def test_what_a_structure_adds_to_a_vehicle_without_it_is_not_identifiable() -> None:
    flight = flown_by("first_order_delay", duration=40.0, seed=5, wind=0.1, noise=0.001)

    for name, extra in (("first_order_delay_lag", "lag"), ("quadratic_drag", "drag_share"), ("dead_zone", "dead_zone")):
        axis = fit([flight], axes=("z",), structure=name).model.axes["z"]
        assert axis.status[extra] == "not_identifiable"
        assert axis.extra[extra] is None
        assert axis.ci95[extra][0] is None
        assert axis.plain is not None
        assert inside(axis, "damping", B)
        if extra == "lag":
            low, high = axis.combinations["delay_plus_lag"].ci95
            assert low is not None
            assert high is not None
            assert low < DELAY < high


def test_levels_that_commands_of_one_size_do_not_show_are_said_to_be_so() -> None:
    axis = fit([flown(Truth(), steps(("z",), seed=3), 30.0, 5)], axes=("z",), structure="saturation").model.axes["z"]

    assert axis.structure == "first_order_delay"
    assert [c.verdict.split(":")[0] for c in axis.candidates] == ["not identifiable"]
    assert axis.status["input"] == "ok"


@pytest.mark.parametrize(
    ("name", "amplitude", "wind"), [("second_order", 0.2, 0.02), ("limited_acceleration", 0.5, 0.3)]
)
def test_a_limit_that_is_not_reached_or_that_gusts_reach_is_not_identifiable(
    name: str, amplitude: float, wind: float
) -> None:
    flight = flown_by(name, amplitude=amplitude, wind=wind, noise=0.001)
    axis = fit([flight], axes=("z",), structure="limited_acceleration").model.axes["z"]

    assert axis.structure == "first_order_delay"
    assert axis.candidates[0].verdict.startswith("not identifiable")


def test_a_model_of_any_structure_is_the_same_after_its_file() -> None:
    for name in ("first_order_delay_lag", "quadratic_drag"):
        model = without_noise(name)
        raw = to_mapping(model)
        back = from_mapping(raw, "here")

        assert to_mapping(back) == raw
        assert back.axes["z"].structure == model.structure == name
        assert set(raw["axes"]["z"]["plain"]["ci95"]) == {"input", "damping", "delay"}
        assert f"z.{next(iter(model.axes['z'].extra))}" in model.covariance_names


@pytest.mark.slow
def test_a_model_with_a_lag_predicts_a_vehicle_with_one_better_than_the_default() -> None:
    train, proof = (flown_by("first_order_delay_lag", seed=seed, wind=0.05, noise=0.0005) for seed in (1, 2))
    errors = []
    for name in ("first_order_delay_lag", "first_order_delay"):
        model = fit([train], axes=("z",), structure=name).model
        near = validate(model, [proof]).flights[0].axes["z"].horizons["1"]
        errors.append(near.velocity_rmse)
    assert errors[0] is not None
    assert errors[1] is not None
    assert errors[0] < 0.8 * errors[1]


@pytest.mark.parametrize(
    "name", ["first_order_delay_lag", "quadratic_drag", "saturation", "second_order", "limited_acceleration"]
)
def test_simulation_moves_as_the_other_integrator_says(name: str) -> None:
    flight = flown_by(name)

    moved = simulate(without_noise(name), flight.command_time, flight.command, flight.pose_time).pose[:, 2]
    np.testing.assert_allclose(moved, flight.position[:, 2] - flight.position[0, 2], rtol=0, atol=0.02)


@pytest.mark.parametrize("name", ["first_order_delay_lag", "second_order"])
def test_residuals_of_another_structure_are_white_of_unit_variance(name: str) -> None:
    flight = flown_by(name, wind=0.05, noise=0.001)
    innovation = residuals(fit([flight], axes=("z",), structure=name).model, flight)["z"].innovation

    assert innovation.std() == pytest.approx(1.0, abs=0.1)
    assert abs(float(innovation[1:] @ innovation[:-1])) < 0.15 * innovation.size


def test_the_state_space_of_a_lag_has_its_poles_and_a_bent_law_has_none() -> None:
    space = state_space(without_noise("first_order_delay_lag"))
    np.testing.assert_allclose(sorted(np.linalg.eigvals(space.A).real), sorted([0.0, -B, -1 / LAG]), atol=0.02)
    steady = -space.C @ np.linalg.pinv(space.A) @ space.B  # of the position, the integrator left out
    assert np.isfinite(steady).all()
    assert (space.A[1:, 1:] @ np.array([G / B, G]) + space.B[1:, 0]) == pytest.approx(np.zeros(2), abs=0.05)

    second = state_space(without_noise("second_order"))
    poles = np.linalg.eigvals(second.A)
    assert np.abs(poles[poles.imag != 0]) == pytest.approx([2.0] * 2, rel=0.01)

    dragged = without_noise("quadratic_drag")
    with pytest.raises(ModelError, match="not linear"):
        state_space(dragged)


def test_an_unknown_structure_and_one_with_the_papers_method_are_said_in_one_line() -> None:
    flight = flown_by("first_order_delay")
    with pytest.raises(ModelError, match="no such structure: 'cubic'; structures are first_order, "):
        fit([flight], structure="cubic")
    with pytest.raises(ModelError, match="leave --structure out"):
        fit([flight], method="paper", structure="second_order")


def test_the_default_of_a_model_is_the_default_law() -> None:
    assert FIRST_ORDER_DELAY.name == STRUCTURE
