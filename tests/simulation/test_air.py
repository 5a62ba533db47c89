"""Air: gusts have the stated variance and the Dryden spectrum, whatever the pieces in which they are drawn."""

import numpy as np
import pytest
from scipy.signal import welch

from rotorfit.simulation.air import Gusts, GustSource, Wind, wind_at_nodes

PERIOD = 0.02
GUSTS = Gusts(intensity=(0.5, 0.4, 0.2), length=1.2, speed=1.5)


def gusts(count: int, seed: int = 5) -> np.ndarray:
    return GustSource(GUSTS, PERIOD, np.random.default_rng(seed)).draw(count)


def test_gusts_have_the_stated_standard_deviation_and_no_mean() -> None:
    series = gusts(400_000)  # 10,000 correlation times: the deviation is known to about 1 %

    assert series.std(axis=0) == pytest.approx(GUSTS.intensity, rel=0.03)
    assert np.abs(series.mean(axis=0)) == pytest.approx(0.0, abs=0.02)


def test_gusts_have_the_spectrum_of_dryden() -> None:
    frequency, density = welch(gusts(1_000_000), fs=1 / PERIOD, nperseg=2048, axis=0)
    band = (frequency > 0.03) & (frequency < 2.5)
    omega, time = 2 * np.pi * frequency[band], GUSTS.length / GUSTS.speed

    along = 2 * time / np.pi / (1 + (time * omega) ** 2)
    across = time / np.pi * (1 + 3 * (time * omega) ** 2) / (1 + (time * omega) ** 2) ** 2
    for axis, form in enumerate((along, across, across)):
        expected = 2 * np.pi * GUSTS.intensity[axis] ** 2 * form  # per Hz, not per rad/s
        assert np.log(density[band, axis] / expected).mean() == pytest.approx(0.0, abs=0.02)
        assert np.abs(np.log(density[band, axis] / expected)).max() < 0.35


def test_gusts_do_not_hang_on_the_pieces_in_which_they_are_drawn() -> None:
    source = GustSource(GUSTS, PERIOD, np.random.default_rng(5))

    pieces = np.concatenate([source.draw(n) for n in (1, 7, 100, 392)])
    np.testing.assert_array_equal(pieces, gusts(500))


def test_wind_is_mean_and_gusts_and_steps_from_their_time_on() -> None:
    wind = Wind(mean=(1.0, 0.0, 0.0), steps=((0.1, (0.0, 2.0, 0.0)), (0.2, (0.0, -2.0, 0.5))))
    added = np.full((15, 3), 0.25)

    air = wind_at_nodes(wind, 0, 15, PERIOD, added) - added
    np.testing.assert_array_equal(air[:, 0], 1.0)
    np.testing.assert_array_equal(air[:6, 1], 0.0)  # nodes at 0 to 0.1 s
    np.testing.assert_array_equal(air[6:11, 1], 2.0)
    np.testing.assert_array_equal(air[11:], [[1.0, 0.0, 0.5]] * 4)


def test_still_air_is_still() -> None:
    assert not GustSource(None, PERIOD, np.random.default_rng(1)).draw(10).any()


@pytest.mark.parametrize("wrong", [{"intensity": (-1.0, 0.0, 0.0)}, {"length": 0.0}, {"speed": -1.0}])
def test_gusts_that_cannot_be_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="gusts"):
        Gusts(**({"intensity": (0.1, 0.1, 0.1)} | wrong))  # type: ignore[arg-type]
