"""The model: file, state space, simulation."""

import json
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from flights import CARD, flown, steps
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, Axis, Model, Predictor, predictor_of, unknown_axis, with_findings
from rotorfit.dynamics.trajectory import simulate, state_space
from rotorfit.estimation.fitting import fit
from rotorfit.files.models import from_mapping, is_model_file, load, save, to_mapping
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth

Array = np.ndarray


@cache
def fitted() -> Model:
    """z and yaw are known, x and y are not."""
    model = fit([flown(Truth(), steps(("z", "yaw")), 30.0, 3)], structure="first_order_delay").model
    return with_findings(model, [Finding("short_data", "warning", "30 s", "wide", "fly longer", "z")])


def of(*points: Predictor | None) -> Model:
    """A model of given points on x, y, z, yaw."""
    axes = {
        name: replace(unknown_axis("ok"), predictor=point) if point else unknown_axis("not_excited")
        for name, point in zip(AXES, points, strict=True)
    }
    return Model(CARD, "first_order_delay", "ml", axes, (), np.zeros((0, 0)), (None,) * 8, (), ())


VEHICLE = of(*(Predictor(GAMMA_B[2 * k], GAMMA_B[2 * k + 1], delay) for k, delay in enumerate((0.15, 0.1, 0.0, 0.31))))


# The file


def test_a_model_survives_the_way_to_a_file_and_back(tmp_path: Path) -> None:
    save(fitted(), tmp_path / "model.json")

    again = load(tmp_path / "model.json")
    assert to_mapping(again) == to_mapping(fitted())
    for name in ("structure", "method", "axes", "covariance_names", "paper", "findings", "flights", "card", "rotorfit"):
        assert getattr(again, name) == getattr(fitted(), name), name
    np.testing.assert_array_equal(again.covariance, fitted().covariance)
    assert again.flights[0].pose_rate == pytest.approx(0.92 * 120, rel=0.05)  # without the stale ones


def test_the_file_is_plain_json_without_nan_in_the_form_of_the_contract(tmp_path: Path) -> None:
    save(fitted(), tmp_path / "model.json")

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    raw = json.loads((tmp_path / "model.json").read_text(), parse_constant=refuse)
    assert (raw["format"], raw["version"], raw["method"]) == ("rotorfit-model", 1, "ml")
    assert len(raw["gamma"]) == 8
    assert raw["gamma"][:4] == [None] * 4
    assert raw["card"] == json.loads(json.dumps(CARD.raw))
    assert set(raw["covariance"]) == {"names", "matrix"}
    assert np.array(raw["covariance"]["matrix"]).shape == (6, 6)
    assert set(raw["flights"][0]) >= {"path", "sha256", "span", "notes"}
    assert raw["findings"][0]["code"] == "short_data"
    for name in AXES:
        axis = raw["axes"][name]
        assert set(axis) >= {"input", "damping", "delay", "stderr", "ci95", "status", "trim", "noise", "predictor"}
        for part in ("stderr", "ci95", "status"):
            assert set(axis[part]) == set(COEFFICIENTS)
        assert all(len(ends) == 2 for ends in axis["ci95"].values())
        assert len(axis["trim"]) in (0, 1)
    assert raw["axes"]["x"]["predictor"] is None
    assert set(raw["axes"]["z"]["predictor"]) == set(COEFFICIENTS)


def test_a_model_that_holds_nan_is_not_written(tmp_path: Path) -> None:
    model = replace(fitted(), covariance=np.full_like(fitted().covariance, np.nan))

    with pytest.raises(ValueError, match="JSON"):
        save(model, tmp_path / "model.json")
    assert not (tmp_path / "model.json").exists()


def damaged(change: Any) -> dict[str, Any]:
    raw: dict[str, Any] = json.loads(json.dumps(to_mapping(fitted())))
    change(raw)
    return raw


@pytest.mark.parametrize(
    "change",
    [
        lambda raw: raw.pop("axes"),
        lambda raw: raw["axes"].pop("yaw"),
        lambda raw: raw["axes"]["z"].pop("status"),
        lambda raw: raw["axes"]["z"]["predictor"].pop("delay"),
        lambda raw: raw["axes"].update(z=None),
        lambda raw: raw["covariance"]["matrix"].pop(),
        lambda raw: raw.update(findings=[{"code": "x"}]),
        lambda raw: raw.update(flights=[{}]),
        lambda raw: raw["flights"][0].update(pose_rate=0.0),
        lambda raw: raw.update(paper=None),
    ],
)
def test_a_damaged_model_is_refused_in_one_line(change: Any) -> None:
    with pytest.raises(ModelError, match=r"here\.json.*damaged") as refused:
        from_mapping(damaged(change), "here.json")
    assert "\n" not in str(refused.value)


def test_a_card_that_is_damaged_inside_a_model_is_refused_by_name() -> None:
    from rotorfit.core.errors import RotorfitError

    with pytest.raises(RotorfitError, match=r"here\.json"):
        from_mapping(damaged(lambda raw: raw["card"].pop("command")), "here.json")


@pytest.mark.parametrize("version", [2, 99, "2", None])
def test_another_version_is_refused_and_named(version: Any) -> None:
    with pytest.raises(ModelError, match=f"version {version!r}"):
        from_mapping(damaged(lambda raw: raw.update(version=version)), "here.json")


@pytest.mark.parametrize("text", ["", "{", "[]", "1", '{"format": "other"}', "\x00\xff", '{"rotorfit-model": 1}'])
def test_what_is_no_model_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(text, encoding="latin-1")

    with pytest.raises(ModelError, match="model"):
        load(path)


def test_a_missing_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot be read"):
        load(tmp_path / "none.json")


def test_a_model_is_told_from_other_files_by_content(tmp_path: Path) -> None:
    save(fitted(), tmp_path / "any.name")
    (tmp_path / "other.json").write_text('{"a": 1}')
    (tmp_path / "text.csv").write_text("rotorfit-model,1\n")
    (tmp_path / "empty").write_bytes(b"")

    assert is_model_file(tmp_path / "any.name")
    for name in ("other.json", "text.csv", "empty"):
        assert not is_model_file(tmp_path / name)


# State space


def test_the_state_space_is_that_of_the_excited_axes() -> None:
    found = state_space(fitted())

    z, yaw = (predictor_of(fitted(), axis) for axis in ("z", "yaw"))
    assert found.axes == ("z", "yaw")
    np.testing.assert_array_equal(found.A, [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, -z.damping, 0], [0, 0, 0, -yaw.damping]])
    np.testing.assert_array_equal(found.B, [[0, 0], [0, 0], [z.input, 0], [0, yaw.input]])
    np.testing.assert_array_equal(found.C, np.eye(2, 4))
    np.testing.assert_array_equal(found.delay, [z.delay, yaw.delay])


def test_the_state_space_moves_as_the_simulation_does_while_the_heading_is_kept() -> None:
    """Discretised at 10 ms; the delays of VEHICLE are multiples of that."""
    still = of(*(VEHICLE.axes[axis].predictor for axis in AXES[:3]), Predictor(1.0, 1.0, 0.0))
    found = state_space(still)
    n, h = 4, 0.01
    command = 0.2 * np.random.default_rng(0).standard_normal((300, 4)) * [1, 1, 1, 0]
    block = np.zeros((3 * n, 3 * n))
    block[: 2 * n, : 2 * n], block[: 2 * n, 2 * n :] = found.A, found.B
    step = expm(block * h)
    late = np.rint(found.delay / h).astype(int)

    state, out = np.zeros(2 * n), []
    for i in range(300):
        out.append(found.C @ state)
        acting = command[np.maximum(i - late, 0), np.arange(n)]
        state = step[: 2 * n, : 2 * n] @ state + step[: 2 * n, 2 * n :] @ acting
    time = np.arange(300) * h
    np.testing.assert_allclose(simulate(still, time, command, time, before=command[0]).pose, out, rtol=0, atol=1e-9)


def test_without_an_excited_axis_there_is_no_state_space_and_no_predictor() -> None:
    with pytest.raises(ModelError, match="no excited axis"):
        state_space(of(None, None, None, None))
    with pytest.raises(ModelError, match="no numbers for x"):
        predictor_of(fitted(), "x")


# Simulation


def integrated(time: Array, command_time: Array, command: Array, start: Array) -> Array:
    """Eq. (5) of VEHICLE by another integrator, from event to event, (N, 8)."""
    points = [predictor_of(VEHICLE, axis) for axis in AXES]
    gain, damping, delay = (np.array([getattr(p, name) for p in points]) for name in COEFFICIENTS)
    events = np.unique(np.concatenate([time, *(command_time + tau for tau in delay)]))
    events = events[(events >= time[0]) & (events <= time[-1])].tolist()
    state, out = start, [start]
    for low, high in pairwise(events):
        middle = 0.5 * (low + high)
        acting = np.array(
            [command[max(int(np.searchsorted(command_time + d, middle)) - 1, 0), k] for k, d in enumerate(delay)]
        )

        def rate(_t: float, x: Array, acting: Array = acting) -> Array:
            c, s = np.cos(x[3]), np.sin(x[3])
            R = np.eye(4)
            R[:2, :2] = [[c, -s], [s, c]]
            return np.concatenate([x[4:], R @ (gain * acting - damping * (R.T @ x[4:]))])

        state = solve_ivp(rate, (low, high), state, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
        if high in time:
            out.append(state)
    return np.array(out)


def test_a_simulation_agrees_with_a_fine_integration_of_the_turning_vehicle() -> None:
    """The heading is straight between the wanted times: at 100 Hz that costs micrometres."""
    rng = np.random.default_rng(1)
    time = np.linspace(0.0, 4.0, 401)
    command_time = np.sort(rng.random(60) * 4)
    command = 0.3 * rng.standard_normal((60, 4))
    start = np.array([1.0, -2.0, 1.5, 0.7, 0.3, -0.2, 0.1, 0.4])

    found = simulate(VEHICLE, command_time, command, time, start[:4], start[4:], command[0])
    expected = integrated(time, command_time, command, start)
    assert np.ptp(found.pose[:, 3]) > 0.4
    np.testing.assert_allclose(found.pose[:, 2:], expected[:, 2:4], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.pose[:, :2], expected[:, :2], rtol=0, atol=2e-5)
    np.testing.assert_allclose(found.velocity, expected[:, 4:], rtol=0, atol=5e-5)


def test_by_default_a_simulation_starts_at_rest_at_the_origin_and_axes_without_a_model_keep_their_velocity() -> None:
    time = np.linspace(0, 2, 21)
    push = np.full((1, 4), 0.2)

    free = simulate(fitted(), np.zeros(1), push, time, velocity=np.array([0.5, -0.25, 0.0, 0.0]))
    np.testing.assert_allclose(free.pose[:, 0], 0.5 * time, atol=1e-12)
    np.testing.assert_allclose(free.pose[:, 1], -0.25 * time, atol=1e-12)
    rest = simulate(fitted(), np.zeros(1), push, time)
    assert not rest.pose[0].any()
    assert not rest.pose[:, :2].any()
    assert rest.pose[-1, 2] > 0.05


def test_a_simulation_is_at_rest_until_the_delay_of_the_first_command_has_passed() -> None:
    time = np.linspace(0, 2, 201)
    push = np.full((1, 4), 0.2)
    moved = simulate(VEHICLE, np.zeros(1), push, time)

    for k, axis in enumerate(AXES):
        point = VEHICLE.axes[axis].predictor
        assert point is not None
        begins = time[np.flatnonzero(moved.velocity[:, k])[0]]
        assert begins == pytest.approx(point.delay + 0.01, abs=1e-6)


def test_a_command_that_is_in_force_before_the_first_acts_until_the_first_does() -> None:
    time = np.linspace(0, 2, 201)
    push = np.full((1, 4), 0.2)

    told = simulate(VEHICLE, np.zeros(1), push, time, before=push[0]).pose
    early = simulate(VEHICLE, np.array([-1.0]), push, time).pose
    np.testing.assert_allclose(told, early, atol=1e-12)


def test_a_simulated_flight_of_the_papers_unstable_vehicle_does_not_depend_on_the_times_asked_for() -> None:
    unstable = of(None, None, Predictor(4.0, -1.5, 0.1), Predictor(5.92, -0.38, 0.0))
    command = np.full((1, 4), 0.1)

    coarse = simulate(unstable, np.zeros(1), command, np.array([0.0, 3.0]))
    fine = simulate(unstable, np.zeros(1), command, np.linspace(0, 3, 301))
    np.testing.assert_allclose(coarse.pose[-1], fine.pose[-1], rtol=1e-6)


def test_findings_are_added_to_a_copy() -> None:
    bare = with_findings(fitted(), [])

    assert bare.findings == ()
    assert len(fitted().findings) == 1


def test_an_unknown_axis_says_why_and_nothing_else() -> None:
    axis: Axis = unknown_axis("too_short")

    assert set(axis.status.values()) == {"too_short"}
    assert (axis.input, axis.damping, axis.delay, axis.predictor, axis.trim) == (None, None, None, None, ())
