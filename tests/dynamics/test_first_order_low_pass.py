"""The first-order low-pass, against scipy's."""

import numpy as np
from scipy.signal import lfilter

from rotorfit.dynamics.first_order_low_pass import first_order_low_pass


def test_series_of_any_shape_are_smoothed_as_by_scipy() -> None:
    series = np.random.default_rng(1).standard_normal((300, 4, 2))
    for values in (series, series[:, :, 0], series[:, 0, 0]):
        expected = lfilter([0.2], [1.0, -0.8], values, axis=0)
        np.testing.assert_allclose(first_order_low_pass(values, 0.8), expected, rtol=1e-12, atol=1e-13)
