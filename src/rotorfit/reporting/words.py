"""Words of the page: definitions of terms, names of axes, numbers as text."""

from collections.abc import Mapping, Sequence
from math import floor, log10
from types import MappingProxyType

from rotorfit.core.frames import AXES

TERMS: Mapping[str, str] = MappingProxyType(
    {
        "input gain": "g: acceleration per unit of command, before the vehicle has gained speed.",
        "damping": "b: how fast the speed fades when the command is zero, as a share per second.",
        "delay": "Time from the stamp of a command until the vehicle begins to answer.",
        "steady gain": "g / b: speed that is reached in the end per unit of a command that lasts.",
        "offset plus delay": "From a command's stamp to its answer's, by two clocks: what is delay cannot be told.",
        "total lag": "delay + 1 / b, with a lag before the velocity + lag, with a zero - zero: by how much the speed "
        "trails behind a command that changes slowly.",
        "lag": "Time constant between a command and the acceleration that answers it: the attitude loop's.",
        "zero": "Time constant Z of the numerator of second_order_zero: as in a velocity loop with feed-forward.",
        "wind": "Acceleration that the commands do not explain, the trim with it: heading frame, 95 % interval.",
        "standard error": "Standard deviation that the estimate would have over repetitions of the flights.",
        "estimate": "The most likely value, with as many digits as its uncertainty deserves.",
        "95 % interval": "Range that holds the true value in 95 of 100 repetitions, if the model is right.",
        "status": "ok; not excited: the command explains nothing; not identifiable: the data do not pin it down; "
        "diverged: no optimum; too short: too little data; refuted: the flights deny the law; pose frozen: the pose "
        "stands still under commands; not fitted: the fit left the axis out.",
        "paper": "What the paper's linear regression, without a delay, gives on the same training flights.",
        "RMS": "Root mean square: the typical size of an error.",
        "velocity error": "Root mean square error of the predicted velocity, over all steps up to the horizon, on "
        "flights that were not fitted.",
        "position error": "Root mean square of the error of the predicted position (yaw: heading) at the end of the "
        "horizon, on flights that were not fitted.",
        "times better": "Error of holding the velocity over error of the model: the smaller of the two factors, of "
        "velocity and of position.",
        "proven": "The errors of velocity and position are at most half of those of holding the velocity, and a paired "
        "test shows that this is no chance (95 %).",
        "in part": "Better than holding the velocity, but less than twice, or not shown to be no chance.",
        "not proven": "No flight that was not fitted moves this axis for long enough; holding it is not moving it.",
        "no": "Less than 1.1 times better than holding the velocity, or shown to be worse.",
        "difference": "Error of this model less that of the other on the same starts, with its standard error; below "
        " 0 this model is better.",
        "at 95 %": "better, worse: the difference is no chance; no difference shown: it may be; too short: unknown.",
        "predictions": "How many starts, 0.5 s apart, were predicted.",
        "Ljung-Box": "Sum of squared autocorrelations; near the number of lags where residuals are white and of one "
        "size. The p-value beside them allows for gusts, and may differ.",
        "past commands": "Whether the residuals follow commands from before them: then part of the answer is left out.",
        "variance": "Size of the residuals beside that of the fit; more: this flight has more wind or noise.",
        "too narrow by": "Factor by which the intervals would be too narrow for residuals of this colour.",
        "expected": "What the meaning and the limits of the card make one expect.",
        "ratio": "Estimate over what is expected.",
        "log-likelihood": "How well the data agree, relative to the chosen optimum; a difference of 2 is notable.",
        "count": "Number of samples, stamps or rows that were concerned.",
        "span": "Seconds of the log that were used, from the first command on.",
        "target": "2 % of the input gain, 5 % of the damping, 5 ms of the delay: a controller does not notice less.",
        "relative to the target": "Standard error over its target; above 1 another flight helps.",
        "RMSE": "Root mean square error over all predictions.",
        "horizon": "How long before the predicted instant the last measurement was made.",
        "holding the velocity": "Naive prediction: the vehicle keeps the velocity that it has.",
        "validation flight": "A flight that was not used to fit the model.",
        "training flight": "A flight that the model was fitted to.",
        "profile likelihood": "The best log-likelihood for each delay when everything else is fitted anew.",
        "starts": "Points from which the search was begun; the more of them agree, the better.",
        "autocorrelation": "How much a residual tells about another one a lag later: 0 nothing, 1 everything.",
        "residual": "One-step prediction error of the model with its disturbance filter, in units of what it expects.",
        "heading frame": "World axes turned by the yaw: x forward, y left.",
        "repair": "What had to be left out or converted before the log could be used, with the number of samples.",
    }
)
"""Term to its meaning, in one sentence."""

COEFFICIENT = MappingProxyType(
    {
        "input": "input gain",
        "damping": "damping",
        "delay": "delay",
        "steady_gain": "steady gain",
        "total_lag": "total lag",
        "offset_plus_delay": "offset plus delay",
    }
)
"""Coefficient to its term."""


def slug(term: str) -> str:
    """A term in the form for an anchor."""
    return "".join(c if c.isalnum() else "-" for c in term)


def term_of(name: str) -> str:
    """The term for a coefficient, a further parameter of a structure, or a combination."""
    return COEFFICIENT.get(name, name.replace("_", " "))


AXIS = MappingProxyType({"x": "forward", "y": "left", "z": "up", "yaw": "turn"})
"""Axis to its positive direction in the heading frame."""


def rounded(value: float | None, scale: float | None = None) -> str:
    """A number rounded according to its uncertainty; an em dash for None.

    Args:
        value: The number.
        scale: Its standard error or the width of its interval, of which two digits are kept; None for three
            significant digits.
    """
    if value is None:
        return "—"
    reference = abs(scale) if scale else abs(value) / 10
    if reference == 0:
        return "0"
    digits = 1 - floor(log10(reference))
    if digits > 6 or abs(value) >= 1e6:
        return f"{value:.3g}"
    return f"{round(value, digits):.{max(digits, 0)}f}".replace("-", "−")


def figure(value: float) -> str:
    """A positive number with about two digits, at most three decimals and no exponent: 0.92, 2.7, 11, 184."""
    if value >= 10:
        return f"{value:.0f}"
    digits = 1 if value >= 0.995 else 2 if value >= 0.0995 else 3
    return f"{value:.{digits}f}"


def chance(p: float) -> str:
    """A p-value as text."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def and_list(names: Sequence[str]) -> str:
    """Names in a list, such as `x, y and z`."""
    return " and ".join(part for part in (", ".join(names[:-1]), *names[-1:]) if part)


def sentences(texts: Sequence[str]) -> tuple[str, ...]:
    """Texts as sentences: each with a full stop, and with a capital unless it begins with the name of an axis."""
    return tuple(f"{t if t.split(' ')[0].strip(':') in AXES else t[:1].upper() + t[1:]}." for t in texts)
