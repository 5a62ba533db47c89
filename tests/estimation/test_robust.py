"""Outliers: found where they are, nowhere else, and what is left gives the answer of the clean flight."""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import binom

from flights import flown, steps, truth_of
from onboard import onboard_card, with_odometry
from rotorfit.app.cli import main
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.axis_estimate import Estimate, estimate_axis
from rotorfit.estimation.likelihood.outliers import GRAIN, jumped, outlier_findings, without_outliers
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight, write_bag

SWAP = (0.05, 0.3)


def swapped(flight: Flight, share: float = 0.01, seed: int = 0, run: int = 1) -> tuple[Flight, Array]:
    """The flight with a share of its poses moved by 5 to 30 cm in any direction, `run` in a row; and their times."""
    rng = np.random.default_rng(seed)
    size = flight.pose_time.size
    first = np.flatnonzero(rng.random(size) < share / run)
    position = flight.position.copy()
    moved = np.zeros(size, bool)
    for i in first:
        direction = rng.standard_normal(3)
        position[i : i + run] += rng.uniform(*SWAP) * direction / np.linalg.norm(direction)
        moved[i : i + run] = True
    return replace(flight, position=position), flight.pose_time[moved]


@cache
def clean() -> Flight:
    return flown(Truth(), steps(("z",), seed=7), 40.0, 7)


@cache
def fitted(method: str, bad: bool) -> Fit:
    flight = swapped(clean(), seed=1)[0] if bad else clean()
    return fit([flight], method, axes=("z",), structure="first_order_delay")  # type: ignore[arg-type]


def of_z(flights: Sequence[Flight]) -> dict[str, Estimate]:
    return {"z": estimate_axis(flights, "z", True)}


@pytest.mark.parametrize("method", ["robust", "paper"])
def test_a_velocity_beside_the_pose_is_left_out_with_a_note(method: str) -> None:
    sim = simulate_flight(Truth(), steps(("z",), seed=7), 10.0, 7)
    for alone in ((), ("x", "y")):
        flight = flight_from_log(with_odometry(sim), onboard_card(alone, independent=True))
        used = fit([flight], method, axes=("z",), structure="first_order_delay").flights[0]  # type: ignore[arg-type]

        assert flight.velocity is not None
        assert used.velocity is None or not used.velocity.of(("z",))
        assert used.velocity_only == alone
        (note,) = [note for note in used.notes if note.code == "velocity_unused"]
        assert "z" in note.text
    assert "velocity_unused" not in {note.code for note in fitted("robust", False).flights[0].notes}


def test_on_a_clean_flight_the_answer_is_that_of_ml() -> None:
    plain, robust = (fitted(method, False).model.axes["z"] for method in ("ml", "robust"))

    for name in COEFFICIENTS:
        assert getattr(robust, name) == getattr(plain, name)
    assert fitted("robust", False).outliers == ((),)


def test_swapped_markers_hurt_ml_and_not_the_robust_method() -> None:
    truth = truth_of(Truth(), "z")
    reference, hurt, robust = (
        fitted(*which).model.axes["z"] for which in (("ml", False), ("ml", True), ("robust", True))
    )

    for name in COEFFICIENTS:
        error = reference.stderr[name]
        assert error is not None
        low, high = robust.ci95[name]
        assert low is not None
        assert high is not None
        assert low < truth[name] < high
        assert abs(getattr(robust, name) - getattr(reference, name)) < 0.5 * error
        assert robust.stderr[name] == pytest.approx(error, rel=0.05)
        wide = hurt.stderr[name]
        assert wide is None or wide > 1.5 * error


def test_the_poses_that_leave_are_those_that_were_swapped() -> None:
    flight, times = swapped(clean(), seed=1)

    ((found,)) = fitted("robust", True).outliers
    scored = times[times > flight.segments[0].start + 0.6]
    out = np.array([one.time for one in found])
    assert np.isin(out, times).all()
    far = np.abs((flight.position - clean().position)[np.isin(flight.pose_time, scored), 2]) > 0.01
    assert np.isin(scored[far], out).all()


@pytest.mark.parametrize("run", [15, 60])
def test_bursts_that_pass_for_motion_are_found_whole(run: int) -> None:
    flight, times = swapped(clean(), 0.03, 5, run)

    _, (found,) = without_outliers([flight], of_z)
    scored = times[times > flight.segments[0].start + 0.6]
    assert scored.size >= run
    caught = np.isin(scored, [one.time for one in found])
    assert caught.mean() > 0.95


@pytest.mark.parametrize("run", [1, 15])
def test_of_a_tenth_of_the_poses_moved_on_all_axes_most_are_suspects_and_few_others(run: int) -> None:
    flight, moved = swapped(clean(), share=0.1, seed=3, run=run)
    suspects = {one.time for burst in jumped(flight) for one in burst}

    assert len(suspects & set(moved)) > 0.8 * moved.size
    assert len(suspects - set(moved)) < 0.2 * moved.size


def test_a_bad_first_pose_is_not_taken_for_the_place_where_the_vehicle_is() -> None:
    first = np.searchsorted(clean().pose_time, clean().segments[0].start + 0.6)
    position = clean().position.copy()
    position[first, 2] += 0.2

    _, (found,) = without_outliers([replace(clean(), position=position)], of_z)
    assert [one.time for one in found] == [clean().pose_time[first]]
    assert found[0].size == pytest.approx(0.2, abs=0.01)


def test_the_flight_carries_a_note_and_the_fit_a_finding_with_count_share_and_largest() -> None:
    result = fitted("robust", True)
    (flight,) = result.flights
    (found,) = result.outliers

    (note,) = (note for note in flight.notes if note.code == "outlier_poses")
    assert note.count == len(found)
    largest = max(one.size for one in found)
    assert f"{largest:.3g} in z" in note.text
    (told,) = outlier_findings(result.flights, result.outliers)
    assert told.severity == "info"
    assert f"{len(found)} poses" in told.evidence
    assert f"{largest:.3g} m" in told.evidence
    assert result.model.method == "robust"


def test_many_outliers_are_a_warning() -> None:
    flight, _ = swapped(clean(), 0.08, 3)
    cleaned, outliers = without_outliers([flight], of_z)

    (told,) = outlier_findings(cleaned, outliers)
    assert told.severity == "warning"


def test_a_coarse_pose_has_no_bursts() -> None:
    grain = replace(clean(), position=np.round(clean().position, 2))
    assert sum(map(len, jumped(clean()))) < 0.01 * clean().pose_time.size
    assert sum(map(len, jumped(grain))) <= GRAIN * grain.pose_time.size


def test_the_outliers_are_told_on_the_command_line(tmp_path: Path) -> None:
    simulated = simulate_flight(Truth(), steps(("z",), seed=7), 30.0, 7)
    pose = simulated.pose.copy()
    pose[1000:1004, 2] += 0.15
    write_bag(replace(simulated, pose=pose), tmp_path / "swapped.bag")

    result = CliRunner().invoke(main, ["fit", str(tmp_path / "swapped.bag"), "--axes", "z", "--method", "robust"])
    assert result.exit_code == 0, result.output
    assert "info outliers:" in result.output
    assert "poses are outliers" in result.output
    assert "by maximum likelihood without outliers" in result.output


def _covered(seed: int) -> list[list[float]]:
    flight = flown(Truth(), steps(("x",), seed=seed), 40.0, seed)
    bad, truth, out = swapped(flight, 0.01, seed)[0], truth_of(Truth(), "x"), []
    for method, some in (("ml", flight), ("robust", flight), ("ml", bad), ("robust", bad)):
        axis = fit([some], method, axes=("x",), structure="first_order_delay").model.axes["x"]  # type: ignore[arg-type]
        for name in COEFFICIENTS:
            low, high = axis.ci95[name]
            hit = low is not None and high is not None and low <= truth[name] <= high
            out.append([getattr(axis.predictor, name), axis.stderr[name] or np.nan, hit])
    return out


@pytest.mark.slow
def test_coverage_with_one_pose_in_a_hundred_swapped_is_that_of_clean_flights() -> None:
    with ProcessPoolExecutor() as pool:
        rows = np.array(list(pool.map(_covered, range(100, 140))), dtype=float).reshape(40, 4, 3, 3)
    value, error, hit = np.moveaxis(rows, 3, 0)

    assert (np.abs(value[:, 1] - value[:, 0]) < 0.05 * error[:, 0]).all()  # clean flights
    assert (np.sqrt(np.mean(((value[:, 3] - value[:, 0]) / error[:, 0]) ** 2, axis=0)) < 0.2).all()
    assert (np.median(error[:, 2] / error[:, 0], axis=0) > 1.1).all()  # what ml pays
    assert np.median(error[:, 2, 2] / error[:, 0, 2]) > 3  # most in the delay
    assert (hit[:, 3].sum(axis=0) >= binom.ppf(0.001, 40, 0.95)).all()
