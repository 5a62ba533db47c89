"""Error bands: stated from the past, right on average, and as wide as what happens."""

from dataclasses import replace

import numpy as np
import pytest
from test_bank import CALM, GUSTY, dynamics_of, flight_in

from rotorfit.core.frames import AXES
from rotorfit.dynamics.error_bands import DRAWN, Bands, _learned, band_scores, error_bands, stated
from rotorfit.dynamics.protocol import predict_flight


@pytest.mark.parametrize(("believed", "real"), [(CALM, CALM), (GUSTY, GUSTY), (CALM, GUSTY), (GUSTY, CALM)])
def test_bands_hold_as_often_as_they_say_also_in_another_wind(believed: object, real: object) -> None:
    """Counted over three flights, x, y and z; yaw is commanded less than its noise."""
    inside = {0.5: [], 0.95: []}  # type: ignore[var-annotated]
    for seed in (3, 4, 5):
        parts = predict_flight(flight_in(real, seed), dynamics_of(believed), 2.0)  # type: ignore[arg-type]
        for horizon in (0.5, 1.0, 2.0):
            bands = error_bands(parts, horizon)
            for nominal, found in inside.items():
                held = np.abs(bands.error) <= bands.half_width(nominal)
                found.append(held[np.isfinite(bands.error[:, 0, 0]), :, :3].mean())
    assert 0.42 <= np.mean(inside[0.5]) <= 0.62
    assert 0.92 <= np.mean(inside[0.95]) <= 0.985


@pytest.mark.parametrize(("rate", "moment"), [(100.0, 20.0), (5.0, 21.0), (4.0, 20.5), (4.0, 21.0)])
def test_bands_are_stated_from_the_past(rate: float, moment: float) -> None:
    """Poses that jump at a moment change no band of before, also where poses are so slow that velocities take long."""
    flight = flight_in(CALM)
    keep = np.unique(np.searchsorted(flight.pose_time, np.arange(*flight.pose_time[[0, -1]], 1 / rate)))
    flight = replace(
        flight, pose_time=flight.pose_time[keep], position=flight.position[keep], yaw=flight.yaw[keep].copy()
    )
    other = replace(flight, position=flight.position + 0.5 * (flight.pose_time > moment)[:, None])
    one, two = (error_bands(predict_flight(f, dynamics_of(CALM), 1.0), 1.0) for f in (flight, other))
    before = one.start < moment
    np.testing.assert_array_equal(one.deviation[before], two.deviation[before])
    np.testing.assert_array_equal(one.freedom[before], two.freedom[before])
    assert not np.array_equal(one.deviation[~before], two.deviation[~before])


def test_errors_twice_as_large_as_predicted_are_learned() -> None:
    start = np.linspace(0.0, 199.5, 400)
    factor, freedom = _learned(start, start + 1.125, np.full((start.size, 2, 4), 4.0), 1.0)

    np.testing.assert_array_equal(factor[:3], 1.0)
    np.testing.assert_array_equal(freedom[:3], DRAWN)
    assert (np.diff(factor[:, 0, 0]) >= 0).all()
    assert 3.6 < factor[-1, 0, 0] < 4.0
    unseen, none = _learned(start, start + 1.125, np.full((start.size, 2, 4), np.nan), 1.0)
    np.testing.assert_array_equal(unseen, 1.0)
    np.testing.assert_array_equal(none, DRAWN)


def test_the_width_is_that_of_students_t() -> None:
    bands = Bands(np.zeros(1), np.zeros((1, 2, 4)), np.full((1, 2, 4), 2.0), np.full((1, 2, 4), 5.0))
    np.testing.assert_allclose(bands.half_width(0.95), 2 * 2.5706, rtol=1e-4)
    np.testing.assert_allclose(bands.half_width(0.5), 2 * 0.7267, rtol=1e-4)


def test_scores_name_both_shares_and_too_few_predictions_give_none() -> None:
    parts = predict_flight(flight_in(CALM), dynamics_of(CALM), 5.0)
    scores = band_scores({h: [stated(part, h) for part in parts] for h in (1.0, 5.0)})

    assert list(scores) == list(AXES)
    for axis in AXES:
        score = scores[axis]["1"]
        assert [c.nominal for c in score.velocity] == [c.nominal for c in score.position] == [0.5, 0.95]
        assert score.velocity[0].width < score.velocity[1].width
        assert score.n > scores[axis]["5"].n > 50
    few = band_scores({1.0: [stated(replace(part, start=part.start + 100.0), 1.0) for part in parts]})["x"]["1"]
    assert few.velocity == few.position == ()
