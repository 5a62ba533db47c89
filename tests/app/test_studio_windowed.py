"""Windows of long series: exact where the pixels allow it, the extremes where not, never a peak lost."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rotorfit.app.web.windowed import COARSE, DENSE, packed, series_over, window_of


def test_a_window_of_few_samples_is_exact_with_one_more_on_each_side() -> None:
    time = np.arange(100) / 10
    window = window_of(series_over(time, np.sin(time)[:, None]), 2.0, 3.0, 800)

    assert window.exact
    assert window.time[0] == time[19]
    assert window.time[-1] == time[31]
    np.testing.assert_array_equal(window.values[:, 0], np.sin(window.time))


def test_a_peak_of_one_sample_among_a_million_is_drawn() -> None:
    time = np.arange(1_000_000) / 200
    values = np.zeros((time.size, 2))
    values[654_321] = 7.0, -7.0

    window = window_of(series_over(time, values), time[0], time[-1], 800)

    assert not window.exact
    assert window.time.size <= 2 * 800
    assert window.values.max(axis=0).tolist() == [7.0, 0.0]
    assert window.values.min(axis=0).tolist() == [0.0, -7.0]
    assert abs(window.time[np.argmax(window.values[:, 0])] - time[654_321]) < time[-1] / 800


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=400).map(lambda steps: np.cumsum(steps)),
    st.floats(-10, 210),
    st.floats(0, 200),
    st.integers(1, 50),
    st.integers(0, 2**32 - 1),
)
def test_what_is_drawn_are_samples_of_the_window_in_order_with_its_extremes(
    time: np.ndarray, start: float, length: float, width: int, seed: int
) -> None:
    values = np.random.default_rng(seed).normal(size=(time.size, 1))
    inside = (time >= start) & (time <= start + length)

    window = window_of(series_over(time, values), start, start + length, width)

    assert np.all(np.diff(window.time) >= 0)
    assert set(window.values.ravel()) <= set(values.ravel())
    assert window.exact == (window.time.size == window.count) or window.time.size <= 2 * width
    if inside.any():
        assert window.values.max() >= values[inside].max()
        assert window.values.min() <= values[inside].min()
        assert window.time.size <= max(DENSE * width, 2 * width) + 2


def test_blanks_stay_blank_and_do_not_hide_their_neighbours() -> None:
    time = np.arange(10_000.0)
    values = np.where(time % 2 == 0, np.nan, time)[:, None]

    window = window_of(series_over(time, values), 0.0, 9_999.0, 100)

    assert np.nanmax(window.values) == 9_999.0
    assert np.isfinite(window.values).all()
    assert np.isnan(window_of(series_over(time, values * np.nan), 0.0, 9_999.0, 100).values).all()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_next_to_nothing_is_drawn_as_it_is(count: int) -> None:
    window = window_of(series_over(np.zeros(count), np.ones((count, 3))), 0.0, 0.0, 10)

    assert window.exact
    assert len(packed(window)) == count * (8 + 3 * 4)


def test_bytes_are_the_stamps_in_double_and_then_the_columns_in_single_precision() -> None:
    time = np.array([1.7e9 + 1e-6, 1.7e9 + 2e-6])
    data = packed(window_of(series_over(time, np.array([[1.0, 2.0], [3.0, np.nan]])), 0.0, 2e9, 10))

    assert np.frombuffer(data[:16], "<f8").tolist() == time.tolist()
    np.testing.assert_array_equal(np.frombuffer(data[16:], "<f4"), [1.0, 3.0, 2.0, np.nan])


def test_long_windows_hold_the_extremes_of_every_pixel_within_one_pixel() -> None:
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.exponential(0.005, 300_000))
    values = np.cumsum(rng.normal(size=(time.size, 1)), axis=0)
    width = 300
    start, end = time[1000], time[-1000]
    assert (time.size - 2000) / width > COARSE

    window = window_of(series_over(time, values), start, end, width)

    pixel = (end - start) / width
    for x in np.linspace(start + 2 * pixel, end - 2 * pixel, 50):
        near = np.abs(window.time - x) <= 1.5 * pixel
        inside, around = np.abs(time - x) <= 0.5 * pixel, np.abs(time - x) <= 2.5 * pixel
        assert values[inside].max() <= window.values[near].max() <= values[around].max()
        assert values[around].min() <= window.values[near].min() <= values[inside].min()


def test_a_value_beyond_what_is_sent_is_infinite_without_a_warning() -> None:
    data = packed(window_of(series_over(np.arange(2.0), np.array([[1e300], [1.0]])), 0.0, 2.0, 10))

    assert np.frombuffer(data[16:], "<f4").tolist() == [np.inf, 1.0]
