"""Controllers in the virtual flight room: a tuned one follows its path, a careless one is reported."""

from dataclasses import replace

import numpy as np
import pytest

from models import model_of
from rotorfit.control import trial
from rotorfit.control.control_law import law_of_bandwidth
from rotorfit.control.controller import HOLD, STEPS, WAIT, AxisControllers, ReferencePath, Steering, commanded
from rotorfit.control.trial import Trial, controller_of, scores_mapping, tracking_error, try_path, try_tuning
from rotorfit.control.tuning import AxisTuning, Tuning, tune
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import AXES
from rotorfit.files.cards import card_from_mapping
from rotorfit.planning.axis_information import AxisBelief
from rotorfit.planning.request import space_of_room
from rotorfit.simulation.air import Gusts, Wind
from rotorfit.simulation.flight_room import Conditions
from rotorfit.simulation.vehicle import load_vehicle

BEBOP = load_vehicle("bebop2")
LINEAR = BEBOP.linear()
TRUTH = {axis: (*LINEAR.gamma[2 * i : 2 * i + 2], LINEAR.delay[i]) for i, axis in enumerate(AXES)}
SPACE = space_of_room("6x6x4")
WINDY = Conditions(wind=Wind((1.0, 1.0, 0.0), Gusts((0.3, 0.3, 0.15))))


def test_a_tuned_controller_follows_a_circle_in_wind() -> None:
    controller = controller_of(tune(model_of(TRUTH), draws=40), BEBOP)  # type: ignore[arg-type]

    trial = try_path(controller, BEBOP, WINDY, ReferencePath("circle", 1.0, 1.0, 20.0), SPACE, 1)
    error = tracking_error(trial)

    assert not trial.failed
    assert error.position < 0.06
    assert error.heading < 0.01
    assert (error.overshoot, error.settling, trial.saturated) == (None, None, 0.0)
    again = try_path(controller, BEBOP, WINDY, ReferencePath("circle", 1.0, 1.0, 20.0), SPACE, 1)
    np.testing.assert_array_equal(again.pose, trial.pose)


def test_gains_for_a_vehicle_without_delay_oscillate_on_one_that_has() -> None:
    hasty = {axis: (g, b, 0.0) for axis, (g, b, _) in TRUTH.items()}
    model = model_of(hasty)
    certain = replace(model, covariance=1e-8 * model.covariance)
    controller = controller_of(tune(certain, "linearising", draws=20), BEBOP)

    trial = try_path(controller, BEBOP, Conditions(), ReferencePath("circle", 1.0, 1.0, 20.0), SPACE, 1)

    assert trial.failed or trial.saturated > 0.5


def test_leaving_the_fence_ends_a_flight() -> None:
    controller = controller_of(tune(model_of(TRUTH), draws=40), BEBOP)  # type: ignore[arg-type]
    wide = ReferencePath("circle", 4.0, 1.0, 20.0, centre=(-4.0, 0.0, 1.5, 0.0))

    trial = try_path(controller, BEBOP, Conditions(), wide, SPACE, 1)

    assert trial.failed
    assert WAIT < trial.time[-1] < 19.0
    assert (tracking_error(trial).position, tracking_error(trial).overshoot) == (np.inf, None)


@pytest.mark.parametrize(("rate", "latency", "flown"), [(50.0, 0.015, 0.015), (50.0, 0.2, 0.2), (400.0, 0.0, 0.00225)])
def test_a_trial_uses_poses_as_old_as_the_gains_are_for(
    rate: float, latency: float, flown: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No younger than half a frame and the jitter, and a fresh one for each command, whatever the rate."""
    ages, stamps, law = [], [], law_of_bandwidth("predictor", AxisBelief(*TRUTH["z"]), 1.0, 1 / rate, latency, 0.03)

    def look(laws: AxisControllers, steering: Steering, t: float, path: ReferencePath) -> tuple[Steering, np.ndarray]:
        ages.append(t - steering.time)
        stamps.append(steering.time)
        return commanded(laws, steering, t, path)

    monkeypatch.setattr(trial, "commanded", look)
    monkeypatch.setattr(trial, "DURATIONS", {"circle": 6.0})
    one = AxisTuning(law, 1.0, None, None, None, None, "")  # type: ignore[arg-type]
    tuning = Tuning("predictor", rate, latency, dict.fromkeys(AXES, one), {})
    model = model_of(TRUTH, card=card_from_mapping(BEBOP.card(), "bebop2"))  # type: ignore[arg-type]
    scores = try_tuning(tuning, model, "bebop2", seeds=1)

    assert scores[0].pose_age == pytest.approx(flown)
    settled = np.array(ages)[int(0.3 * rate) :]
    assert settled.mean() == pytest.approx(flown, abs=0.001)
    assert np.mean(np.diff(stamps[int(0.3 * rate) :]) > 0) > 0.9


def made_up(overshoot: float, settled: float) -> Trial:
    """Steps that are answered after a time by exactly the step, with a peak at the start of each."""
    path = ReferencePath("steps", 1.0, 1.0, WAIT + HOLD * len(STEPS))
    time = np.arange(0.0, path.duration, 0.04)
    reference, pose = path.at(time)[0], path.at(np.maximum(time - settled, 0.0))[0]
    since = (time - WAIT) % HOLD
    peak = (time >= WAIT + settled) & (since >= settled) & (since < settled + 0.2)
    before = path.at(np.maximum(time - HOLD, 0.0))[0]
    return Trial(path, time, pose + peak[:, None] * overshoot * (reference - before), reference, 0.0, False)


def test_overshoot_and_settling_are_those_of_the_steps() -> None:
    error = tracking_error(made_up(0.07, 1.0))

    assert error.overshoot == pytest.approx(0.07)
    assert error.settling == pytest.approx(1.0, abs=0.05)
    late = tracking_error(made_up(0.3, 1.0))
    assert late.settling == pytest.approx(1.2, abs=0.05), "a peak beyond the band is not settled"


def test_gains_are_tried_on_the_vehicle_that_they_are_for() -> None:
    model = model_of(TRUTH, card=card_from_mapping(BEBOP.card(), "bebop2"))  # type: ignore[arg-type]
    scores = try_tuning(tune(model, draws=40), model, "bebop2,wind=1", seeds=1)

    assert [one.path.shape for one in scores] == ["circle", "lemniscate", "steps"]
    assert [one.failed for one in scores] == [0, 0, 0]
    assert scores[0].error.position < scores[2].error.position
    told = scores_mapping(scores)
    assert told["steps"]["overshoot"] == scores[2].error.overshoot
    assert told["circle"]["overshoot"] is None
    with pytest.raises(ModelError, match="not one of Ryze Tello"):
        try_tuning(tune(model, draws=20), model, "tello")
    with pytest.raises(ModelError, match="none for y, z and yaw: not in --axes"):
        try_tuning(tune(model, axes=("x",), draws=20), model, "bebop2")
