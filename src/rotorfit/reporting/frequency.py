"""Presentation of frequency responses: rows of a table, a line about the test, charts."""

from collections.abc import Mapping, Sequence

import numpy as np

from rotorfit.core.frames import AXES, POSE_UNITS, Array
from rotorfit.core.frequency_response import DOUBTED, ResponseComparison
from rotorfit.reporting.views import Chart, Line

Comparisons = Sequence[Mapping[str, ResponseComparison]]


def response_rows(comparison: ResponseComparison) -> list[list[str]]:
    """Frequency, gain, its band, the model's, delay, its band, the model's, coherence; a star marks values outside."""
    flight, rows = comparison.flight, []
    for k, omega in enumerate(flight.frequency):
        gain = [f"{flight.gain[k]:.3f}", f"{flight.gain_band[k, 0]:.3f} to {flight.gain_band[k, 1]:.3f}"]
        delay = [f"{1e3 * flight.delay[k]:.0f}", " to ".join(_ms(end) for end in flight.delay_band[k])]
        model = ["-", "-"]
        if comparison.model is not None:
            model = [
                f"{comparison.model_gain[k]:.3f}{_star(comparison.model_gain[k], flight.gain_band[k])}",
                f"{1e3 * comparison.model_delay[k]:.0f}{_star(comparison.model_delay[k], flight.delay_band[k])}",
            ]
        rows.append([f"{omega:.2f}", *gain, model[0], *delay, model[1], f"{flight.coherence[k]:.3f}"])
    return rows


def _ms(end: float) -> str:
    return f"{1e3 * end:.0f}" if np.isfinite(end) else "open"


def _star(value: float, band: Array) -> str:
    return "" if band[0] <= value <= band[1] else "*"


def response_line(comparison: ResponseComparison) -> str:
    """The result of the test of the law, or why there is none.

    The p-value is of all frequencies together, the deviation is the largest among them, both with the law's best
    coefficients for this flight.
    """
    law, flight = comparison.law, comparison.flight
    if not flight.frequency.size:
        return f"no frequency response: {flight.why_none}"
    if law is None:
        return "the law has no frequency response to compare" if comparison.model is None else "too few for a test"
    many, missed = flight.frequency.size, _missed(comparison)
    verdict = "inconsistent with the law for any coefficients" if law.p < DOUBTED else "hardly consistent with the law"
    if law.p >= 0.05:
        other = f" at other coefficients, as the model misses a band at {missed} of {many}"
        verdict = f"consistent with the law{other if missed > max(1, many / 4) else ''}"
    worst = f"the worst of {many} is off" if many > 1 else "it is off"
    return (
        f"{'all frequencies together' if many > 1 else 'its one frequency'}: {verdict} (p = {law.p:.3g}, {law.freedom} "
        f"degree{'s' * (law.freedom != 1)} of freedom); {worst} by {law.worst_share:.1f} times its 95 % band, "
        f"at {law.worst:.2g} rad/s; instrument: {flight.instrument}"
    )


def _missed(comparison: ResponseComparison) -> int:
    """Number of frequencies at which the model's gain or delay lies outside the flight's band."""
    if comparison.model is None:
        return 0
    flight, out = comparison.flight, np.zeros(comparison.flight.frequency.size, bool)
    for value, band in ((comparison.model_gain, flight.gain_band), (comparison.model_delay, flight.delay_band)):
        out |= (value < band[:, 0]) | (value > band[:, 1])
    return int(out.sum())


def response_charts(comparisons: Comparisons) -> tuple[Chart, ...]:
    """Gain and delay over frequency, the flight's with its bands beside the model's, one flight for each axis.

    It is the flight on which the most frequencies are known.
    """
    charts: list[Chart] = []
    for axis in AXES:
        mine = [each[axis] for each in comparisons if axis in each and each[axis].flight.frequency.size]
        if mine:
            chosen = max(mine, key=lambda each: each.flight.frequency.size)
            charts += [_chart(chosen, "gain"), _chart(chosen, "delay")]
    return tuple(charts)


def _chart(comparison: ResponseComparison, what: str) -> Chart:
    flight, gain = comparison.flight, what == "gain"
    x, factor = flight.frequency, 1.0 if gain else 1e3
    value, band = (flight.gain, flight.gain_band) if gain else (flight.delay, flight.delay_band)
    model, sides = (
        (comparison.model_gain, comparison.gain_band) if gain else (comparison.model_delay, comparison.model_delay_band)
    )
    lines = [Line("the flight itself", "measured", factor * value)]
    lines += [Line("95 % band", "band", factor * np.where(np.isfinite(end), end, np.nan)) for end in band.T]
    outside = 0
    if comparison.model is not None:
        lines.append(Line("this model", "model", factor * model))
        known = np.isfinite(sides).all(axis=1)
        if known.any():
            lines += [Line("the model's 95 % band", "paper", np.where(known, factor * end, np.nan)) for end in sides.T]
        outside = int(np.sum((model < band[:, 0]) | (model > band[:, 1])))
    shown = [factor * value, *([factor * model] if comparison.model is not None else [])]
    low, high = min(float(np.min(y)) for y in shown), max(float(np.max(y)) for y in shown)
    margin = 0.25 * (high - low) or 0.1 * abs(high) or 1.0
    return Chart(
        kind=f"response_{what}",
        axis=flight.axis,
        title=f"{flight.axis}: {what} over frequency",
        x_label="frequency [rad/s]",
        y_label=f"gain [{POSE_UNITS[flight.axis]}/s per command]" if gain else "delay [ms]",
        x=x,
        lines=tuple(lines),
        reading="What the flight itself answers to a sine of each frequency, without any law, and thin lines for its "
        "95 % bands: where the model leaves them, the law or its numbers are wrong at that frequency.",
        summary=f"{flight.axis}: the model's {what} lies outside the flight's band at {outside} of {x.size} "
        f"frequencies, {x[0]:.2g} to {x[-1]:.2g} rad/s{f'; {response_line(comparison)}' if gain else ''}.",
        y_range=(low - margin, high + margin),
    )
