"""Signals that excite one axis: their size, spectrum, timing and sign."""

import numpy as np
import pytest

from rotorfit.core.flight_plan import Chirp, Sines, Steps, motion, value
from rotorfit.planning.signals import (
    TAPS,
    crest_factor,
    designed,
    ident_reference,
    maximum_length_sequence,
    multisine,
    paper_sines,
    scaled,
)

BAND = (0.8, 6.0)
DESIGNS = ("multisine", "chirp", "doublets", "3211", "prbs")


@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("place", [0, 1])
def test_every_design_reaches_its_amplitude_and_does_not_pass_it(design: str, place: int) -> None:
    largest = np.max(np.abs(value(designed(design, 0.4, 60.0, BAND, place, 2), np.arange(0.0, 60.0, 0.002))))
    assert largest <= 0.4 * (1 + 1e-3)
    assert largest > 0.4 * (1 - 1e-3)


@pytest.mark.parametrize("design", ["doublets", "3211", "prbs"])
def test_steps_end_at_zero_within_the_duration(design: str) -> None:
    signal = designed(design, 0.4, 37.0, BAND)
    assert isinstance(signal, Steps)
    assert signal.time[-1] <= 37.0
    assert signal.level[-1] == 0.0
    assert np.all(np.diff(signal.time) > 0)


def test_a_multisine_is_much_flatter_than_sines_in_phase_and_than_schroeder_phases() -> None:
    flat = multisine(1.0, 60.0, BAND)
    k = np.arange(1, len(flat.phase) + 1)
    schroeder = Sines(flat.amplitude, flat.frequency, tuple(-np.pi * k * (k - 1) / k.size))
    in_phase = Sines(flat.amplitude, flat.frequency, (np.pi / 2,) * k.size)
    assert crest_factor(in_phase, 60.0) == pytest.approx(np.sqrt(2 * k.size), rel=1e-3)
    assert crest_factor(flat, 60.0) < 1.9 < crest_factor(schroeder, 60.0)


def test_the_crest_factor_of_known_signals() -> None:
    assert crest_factor(Sines((2.0,), (1.0,), (0.3,)), 20 * np.pi) == pytest.approx(np.sqrt(2), rel=1e-4)
    assert crest_factor(Steps((0.0, 5.0), (1.0, -1.0)), 10.0) == pytest.approx(1.0)


def test_multisines_flown_together_share_no_frequency_and_are_orthogonal() -> None:
    one, other = (multisine(1.0, 60.0, BAND, place, 2) for place in (0, 1))
    assert not set(np.rint(np.array(one.frequency) * 60 / 2 / np.pi)) & set(
        np.rint(np.array(other.frequency) * 60 / 2 / np.pi)
    )
    t = np.arange(0.0, 60.0, 0.01)
    assert abs(np.mean(value(one, t) * value(other, t))) < 1e-9


def test_a_multisine_keeps_to_its_band() -> None:
    frequency = np.array(multisine(1.0, 60.0, BAND).frequency)
    grid = 2 * np.pi / 60
    assert BAND[0] - grid <= frequency.min() <= frequency.max() <= BAND[1] + grid
    assert np.allclose(frequency / grid, np.rint(frequency / grid))


@pytest.mark.parametrize("bits", TAPS)
def test_a_maximum_length_sequence_is_one_more_than_half_ones_and_white(bits: int) -> None:
    sequence = maximum_length_sequence(bits, seed=5)
    signal = 2.0 * sequence - 1
    assert sequence.size == 2**bits - 1
    assert signal.sum() == 1
    correlation = np.fft.ifft(np.abs(np.fft.fft(signal)) ** 2).real
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-8)


def test_a_prbs_has_two_levels_its_clock_and_a_spectrum_flat_up_to_its_band() -> None:
    signal = designed("prbs", 0.3, 120.0, BAND, seed=2)
    assert isinstance(signal, Steps)
    assert set(np.round(np.abs(signal.level[:-1]), 12)) == {0.3}
    clock = 2.8 / BAND[1]
    np.testing.assert_allclose(
        np.array(signal.time[:-1]) / clock, np.rint(np.array(signal.time[:-1]) / clock), atol=1e-9
    )
    t = np.arange(0.0, 120.0, 0.02)
    power = np.abs(np.fft.rfft(value(signal, t))) ** 2
    frequency = 2 * np.pi * np.fft.rfftfreq(t.size, 0.02)
    low, high = (power[(frequency > a) & (frequency < b)].mean() for a, b in ((0.3, 2.0), (4.5, 6.0)))
    assert 0.3 < high / low < 1.3


def test_another_seed_is_another_sequence_and_the_same_seed_the_same() -> None:
    assert designed("prbs", 0.3, 60.0, BAND, seed=1) == designed("prbs", 0.3, 60.0, BAND, seed=1)
    assert designed("prbs", 0.3, 60.0, BAND, seed=1) != designed("prbs", 0.3, 60.0, BAND, seed=2)


def test_3211_holds_3_2_1_1_units_with_changing_sign_then_the_same_mirrored() -> None:
    signal = designed("3211", 0.5, 60.0, BAND)
    assert isinstance(signal, Steps)
    unit = 2 * np.pi / (3 * np.sqrt(BAND[0] * BAND[1]))
    np.testing.assert_allclose(np.diff(signal.time[:11]) / unit, [3, 2, 1, 1, 2, 3, 2, 1, 1, 2])
    np.testing.assert_allclose(np.array(signal.level[:10]) / 0.5, [1, -1, 1, -1, 0, -1, 1, -1, 1, 0])


def test_a_pair_of_doublets_brings_an_undamped_vehicle_back_to_rest() -> None:
    signal = designed("doublets", 0.5, 60.0, BAND)
    assert isinstance(signal, Steps)
    width = np.pi / BAND[0]
    np.testing.assert_allclose(np.diff(signal.time[:6]), width)
    t = np.arange(0.0, 6 * width, 1e-3)
    velocity = np.cumsum(value(signal, t)) * 1e-3
    position = np.cumsum(velocity) * 1e-3
    assert abs(velocity[-1]) < 2e-3
    assert abs(position[-1]) < 5e-3 * np.max(np.abs(position))


def test_a_chirp_runs_from_end_to_end_of_the_band_and_the_other_way_on_the_second_axis() -> None:
    up, down = (designed("chirp", 0.5, 60.0, BAND, place, 2) for place in (0, 1))
    assert isinstance(up, Chirp)
    assert isinstance(down, Chirp)
    assert (up.frequency, down.frequency) == (BAND, BAND[::-1])
    start, end = motion(Chirp(1.0, BAND, 60.0), np.array([0.0, 60.0]))[1]
    assert start == pytest.approx(BAND[0])
    assert abs(end) <= BAND[1]


def test_the_ident_manoeuvre_moves_as_drone_dev_does() -> None:
    t = np.linspace(0, 40, 200)
    np.testing.assert_allclose(value(ident_reference("x"), t), 0.25 * (np.sin(0.4 * t) + np.sin(t)), atol=1e-12)
    np.testing.assert_allclose(value(ident_reference("yaw"), t), 0.525 * (np.cos(0.4 * t) + np.cos(t)), atol=1e-12)


@pytest.mark.parametrize("signal", [paper_sines("x"), Chirp(0.3, BAND, 20.0), Steps((0.0, 1.0), (0.2, 0.0))])
def test_scaling_a_signal_scales_its_values(signal: Sines | Chirp | Steps) -> None:
    t = np.linspace(0, 20, 300)
    np.testing.assert_allclose(value(scaled(signal, 0.7), t), 0.7 * value(signal, t), atol=1e-15)


def test_a_design_that_does_not_exist_and_an_empty_band_are_refused() -> None:
    with pytest.raises(ValueError, match="no such design"):
        designed("sweep", 1.0, 60.0, BAND)
    with pytest.raises(ValueError, match="empty"):
        designed("chirp", 1.0, 60.0, (3.0, 2.0))


@pytest.mark.parametrize("design", ["multisine", "chirp", "doublets", "3211", "prbs"])
def test_axes_that_are_flown_together_get_signals_of_their_own(design: str) -> None:
    time = np.arange(0.0, 58.0, 0.02)

    signals = [value(designed(design, 0.5, 58.0, (1.8, 10.0), place, 4), time) for place in range(4)]
    assert np.max(np.abs(np.corrcoef(signals)[np.triu_indices(4, 1)])) < 0.3
