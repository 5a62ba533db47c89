"""The table of estimators, from which command line, studio, comparison, summary and report take their lists and labels.

A new estimator is a function `estimate(flights, axes) -> MethodResult` in a module of its own, and one row here. This
module imports nothing heavy, so that `rotorfit --help` can read it.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """An estimator of the coefficients.

    Attributes:
        label: Name in words, to follow "fitted by".
        estimator: `module:function` of a regression, called with the flights and `("z",)`, `("yaw",)` or `("x", "y")`;
            empty for the likelihood and the paper's regression, which `fit` runs itself.
        likelihood: Whether it maximises the likelihood: only then it has profiles and an accuracy table and accepts
            priors.
        bias: What biases a regression, which its intervals leave out; empty for the likelihood.
        in_comparison: Whether it is a row of the comparison of methods.
    """

    label: str
    estimator: str = ""
    likelihood: bool = False
    bias: str = ""
    in_comparison: bool = True


_REGRESSION = "rotorfit.estimation.regression"
_FEEDBACK = "feedback, unless the card names the `[reference]` of the controller"
_NOISE = "noise in the velocity, wind with a memory, feedback"

METHODS: Mapping[str, Method] = {
    "ml": Method("maximum likelihood", likelihood=True),
    "robust": Method("maximum likelihood without outliers", likelihood=True, in_comparison=False),
    "paper": Method("the paper's regression, without delay", bias="the omitted delay, noise, wind, feedback"),
    "svf": Method("least squares with a state-variable filter", f"{_REGRESSION}.least_squares:svf", bias=_NOISE),
    "weak": Method("least squares on the weak form", f"{_REGRESSION}.least_squares:weak", bias=_NOISE),
    "iv": Method("refined instrumental variables", f"{_REGRESSION}.instrumental_variables:iv", bias=_FEEDBACK),
    "oe": Method("output error", f"{_REGRESSION}.output_error:oe", bias="feedback"),
}
"""Name to estimator, in the order of all lists."""

BEST = "ml"
"""The default, and the method that the others are tested against."""


def label_of(method: str) -> str:
    """Label of a method; its name if this version does not know the method that a model file names."""
    return METHODS[method].label if method in METHODS else method


def maximises_likelihood(method: str) -> bool:
    """Whether a method maximises the likelihood; False for an unknown one."""
    return method in METHODS and METHODS[method].likelihood


def compared_methods() -> tuple[str, ...]:
    """Rows of the comparison of methods; the others are tested against the last one."""
    return (*(name for name, method in METHODS.items() if method.in_comparison and name != BEST), BEST)
