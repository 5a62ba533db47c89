"""Words of the page: definitions on hover, names of axes, numbers for people."""

from collections.abc import Mapping
from math import floor, log10
from types import MappingProxyType

TERMS: Mapping[str, str] = MappingProxyType(
    {
        "input gain": "g: acceleration per unit of command, before the vehicle has gained speed.",
        "damping": "b: how fast the speed fades when the command is zero, as a share per second.",
        "delay": "Time from the stamp of a command until the vehicle begins to answer.",
        "steady gain": "g / b: speed that is reached in the end per unit of a command that lasts.",
        "total lag": "delay + 1 / b: by how much the speed trails behind a command that changes slowly.",
        "standard error": "Standard deviation that the estimate would have over repetitions of the flights.",
        "95 % interval": "Range that holds the true value in 95 of 100 repetitions, if the model is right.",
        "status": "ok; not excited: the command explains nothing; not identifiable: the data do not pin it down; "
        "diverged: no optimum; too short: too little data.",
        "paper": "What the paper's linear regression, without a delay, gives on the same training flights.",
        "RMS": "Root mean square: the typical size of an error.",
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
"""What a term means, in one sentence."""

COEFFICIENT = MappingProxyType(
    {
        "input": "input gain",
        "damping": "damping",
        "delay": "delay",
        "steady_gain": "steady gain",
        "total_lag": "total lag",
    }
)
"""Coefficient to its term."""


def term_of(name: str) -> str:
    """Term of a coefficient, a further parameter of a structure, or a combination."""
    return COEFFICIENT.get(name, name.replace("_", " "))


AXIS = MappingProxyType({"x": "forward", "y": "left", "z": "up", "yaw": "turn"})
"""Axis to its positive direction in the heading frame."""


def rounded(value: float | None, scale: float | None = None) -> str:
    """A number with as many digits as its uncertainty deserves; an em dash for None.

    Args:
        value: To be printed.
        scale: Its standard error or interval's width: two digits of that are kept; None for three of the value.
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
