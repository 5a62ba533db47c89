"""The table of estimators. Command line, studio, comparison, summary and report take their lists and words from it.

A new estimator is a function `estimate(flights, axes) -> MethodResult` in a module of its own and one row here. This
module imports nothing heavy, so that `rotorfit --help` can read it.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Method:
    """An estimator of the coefficients.

    Attributes:
        label: What it is, as said after "fitted by".
        estimator: `module:function` of a regression, called with the flights and `("z",)`, `("yaw",)` or `("x", "y")`;
            empty for the likelihood and the paper's regression, which `fit` runs itself.
        likelihood: Whether it maximises the likelihood: then it has profiles, takes priors and has an accuracy table.
        in_comparison: Whether it is a row of the comparison of methods.
    """

    label: str
    estimator: str = ""
    likelihood: bool = False
    in_comparison: bool = True


_REGRESSION = "rotorfit.estimation.regression"

METHODS: Mapping[str, Method] = {
    "ml": Method("maximum likelihood", likelihood=True),
    "robust": Method("maximum likelihood without outliers", likelihood=True, in_comparison=False),
    "paper": Method("the paper's regression, without delay"),
    "svf": Method("least squares behind a state-variable filter", f"{_REGRESSION}.least_squares:svf"),
    "weak": Method("least squares on the weak form", f"{_REGRESSION}.least_squares:weak"),
    "iv": Method("refined instrumental variables", f"{_REGRESSION}.instrumental_variables:iv"),
    "oe": Method("output error", f"{_REGRESSION}.output_error:oe"),
}
"""Name to estimator, in the order of lists."""

BEST = "ml"
"""The default, and what the others are tested against."""


def label_of(method: str) -> str:
    """What a method is, in words; its name where a model file names one that this version does not know."""
    return METHODS[method].label if method in METHODS else method


def maximises_likelihood(method: str) -> bool:
    """Whether a method, known or not, is one of the likelihood."""
    return method in METHODS and METHODS[method].likelihood


def compared_methods() -> tuple[str, ...]:
    """The rows of the comparison of methods; the last one is what the others are tested against."""
    return (*(name for name, method in METHODS.items() if method.in_comparison and name != BEST), BEST)
