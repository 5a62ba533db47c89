"""The frequency response of an axis from the flight alone: no law of the vehicle is assumed.

At the tones of the command, otherwise at knots over the frequencies where it has power: velocity (for yaw the rate) per
command, with 95 % bands of gain and delay and the share of the motion that the command explains. What moved the command
from outside any loop is the instrument: its own tones, the recorded reference, or, if nothing responds to the motion,
the command itself.

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 2012, chapters 2 and 7;
M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., 2012, for the use of it.
"""

import numpy as np

from rotorfit.assessment.frequency.bands import Band, bands_of
from rotorfit.assessment.frequency.loop import answers_motion
from rotorfit.assessment.frequency.spectra import (
    SHORTEST,
    TURNED,
    Window,
    runs_of,
    spectra_of,
    window_tones,
    windows_of,
)
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.frequency_response import FrequencyResponse, Instrument
from rotorfit.core.results import Motion, student_quantile
from rotorfit.diagnosis.position_loop import restoring_law
from rotorfit.dynamics.tones import SOME_TONES, Tones

ALL_TONES = 0.9
"""Share of a command's variance in its tones above which only these are used, loop or no loop."""

VAGUE = 0.4
"""Ratio of standard error to gain above which a value is left out."""


def frequency_response(flight: Flight, axis: str) -> FrequencyResponse:
    """The frequency response of an axis, from the flight alone.

    Args:
        flight: Any flight.
        axis: `x`, `y`, `z` or `yaw`.

    Returns:
        The response; without frequencies, and with the reason, if the flight does not determine it.

    Raises:
        ValueError: `axis` is not an axis.
    """
    bands, instrument, why = response_bands(flight, axis)
    return response_of_bands(axis, bands, instrument, why)


def response_bands(flight: Flight, axis: str, motion: Motion | None = None) -> tuple[tuple[Band, ...], Instrument, str]:
    """The bands of an axis, their instrument, and, if there are none, the reason; `motion` as in `compared`."""
    k = AXES.index(axis)
    if axis not in flight.axes or not np.ptp(flight.command[:, k]) > 0:
        return (), "none", f"{axis} is not commanded"
    windows = windows_of(flight, axis)
    if not windows:
        turned = f"the heading turns by more than {np.degrees(TURNED):.0f} deg from its mean"
        return (), "none", turned if any(runs_of(flight)) else f"no {SHORTEST:g} s without a hole in commands or poses"
    if restoring_law(flight, axis, motion) is not None:
        return (), "none", f"the command of {axis} is only a controller's response to the motion"
    every = [window_tones(window) for window in windows]
    share = min(tones.share for tones in every)
    loop = share < ALL_TONES and answers_motion(windows)
    if not loop and share < ALL_TONES:
        return bands_of([spectra_of(window) for window in windows]), "command", ""
    if share > SOME_TONES and all(tones.frequency.size for tones in every):
        parts = [spectra_of(window, tones) for window, tones in zip(windows, every, strict=True)]
        return bands_of(parts, _common(every, windows)), "tones", ""
    told = [window.reference for window in windows]
    if all(each is not None and np.ptp(each) > 0 for each in told):
        return bands_of([spectra_of(w, each) for w, each in zip(windows, told, strict=True)]), "reference", ""
    return (
        (),
        "none",
        f"the command of {axis} responds to its motion, and no excitation from outside is known: no tones, no "
        "recorded reference",
    )


def _common(every: list[Tones], windows: tuple[Window, ...]) -> Array:
    """Lines of all windows, merged where closer than a bin, shape (K,) [rad/s]."""
    lines = np.sort(np.concatenate([tones.frequency for tones in every]))
    bin_ = 2 * np.pi / max(window.duration for window in windows)
    parts = np.split(lines, np.flatnonzero(np.diff(lines) > bin_) + 1)
    return np.array([part.mean() for part in parts if part.size])


def response_of_bands(axis: str, bands: tuple[Band, ...], instrument: Instrument, why: str) -> FrequencyResponse:
    """The response at those knots where it is known well enough."""
    if not bands:
        nothing = np.zeros(0)
        return FrequencyResponse(
            axis,
            nothing,
            np.zeros(0, np.complex128),
            np.zeros((0, 2)),
            nothing,
            nothing,
            "none",
            why or "the command has no power",
        )
    frequency, response = (np.concatenate([getattr(band, name) for band in bands]) for name in ("knots", "response"))
    stderr = np.concatenate([_stderr(band) for band in bands])
    quantile = np.concatenate([np.full(band.knots.size, student_quantile(band.freedom)) for band in bands])
    coherence = np.concatenate([_coherence(band) for band in bands])
    clear = stderr.max(axis=1) < VAGUE * np.abs(response)
    if not clear.any():
        return response_of_bands(axis, (), "none", "the motion is too noisy at every frequency")
    return FrequencyResponse(
        axis, frequency[clear], response[clear], stderr[clear], quantile[clear], coherence[clear], instrument
    )


def _stderr(band: Band) -> Array:
    """Standard errors at each knot, parallel to the response and perpendicular to it, shape (J, 2)."""
    J, turn = band.knots.size, np.angle(band.response)
    along = np.hstack([np.diag(np.cos(turn)), np.diag(np.sin(turn))])
    across = np.hstack([-np.diag(np.sin(turn)), np.diag(np.cos(turn))])
    variances = [np.diag(rows @ band.covariance @ rows.T) for rows in (along, across)]
    return np.asarray(np.sqrt(np.reshape(variances, (2, J))).T)


def _coherence(band: Band) -> Array:
    """Share of the power around each knot that follows the command, shape (J,)."""
    J = band.knots.size
    signal = np.abs(band.response) ** 2 * np.sum(band.share[:, :J] ** 2, axis=0)
    return np.asarray(signal / (signal + band.noise * band.motion.size / J))
