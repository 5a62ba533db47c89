"""What a prior did to a fit: how far it moved each coefficient, and its share of the information."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rotorfit.core.accuracy import PriorUse
from rotorfit.core.finding import Finding
from rotorfit.core.frames import Array, Mask
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.results import Fit
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.estimation.likelihood.prior import prior_of_law

CONFLICT = 3.0
"""Difference between prior and data, in combined standard errors, above which they conflict."""


def with_influence(fit: Fit) -> Fit:
    """Adds to the model of a fit what the prior did to each coefficient that it covers."""
    card = fit.model.card
    uses = {}
    for axis, estimate in fit.estimates.items():
        optimum, k = estimate.optimum, estimate.place
        prior, K = optimum.prior, optimum.point.gain.size
        if prior is None or fit.model.axes[axis].predictor is None:
            continue
        law = prior_of_law(prior, K)  # whatever the card says
        data = maximise(estimate.records, optimum.point, optimum.free, restricted=optimum.restricted, prior=law)
        alone, both = data.point.flat(), optimum.point.flat()
        data_error, error = (_errors(o.score.information, o.free) for o in (data, optimum))
        for i, name in enumerate(COEFFICIENTS):
            at = i * K + k
            if not prior.precision[at]:
                continue
            combined = np.hypot(data_error[at], prior.precision[at] ** -0.5)
            uses[f"{axis}.{name}"] = PriorUse(
                mean=card.prior[axis][name].mean,
                sd=card.prior[axis][name].sd,
                data=float(np.exp(alone[at]) if name == "damping" else alone[at]),
                moved=float((both[at] - alone[at]) / data_error[at]),
                share=float(prior.precision[at] * error[at] ** 2),
                conflict=float(abs(alone[at] - prior.mean[at]) / combined),
            )
    return replace(fit, model=replace(fit.model, prior=uses))


def prior_findings(fit: Fit) -> Iterator[Finding]:
    """Findings that a prior was used, and where it contradicts the data."""
    uses = fit.model.prior or {}
    for axis in fit.estimates:
        own = {name: uses[f"{axis}.{name}"] for name in COEFFICIENTS if f"{axis}.{name}" in uses}
        if not own:
            continue
        moved = ", ".join(f"{name} by {use.moved:+.2f}" for name, use in own.items())
        share = ", ".join(f"{100 * use.share:.2g} % of what is known of {name}" for name, use in own.items())
        yield Finding(
            "prior_used",
            "info",
            f"the card's prior moved {axis}: {moved} standard errors of the flight alone",
            f"the prior is {share}; the rest is the flight's",
            "leave --prior out to see what the flight says alone",
            axis,
        )
        torn = {name: use for name, use in own.items() if use.conflict > CONFLICT}
        for name, use in torn.items():
            yield Finding(
                "prior_conflict",
                "warning",
                f"the card expects {name} of {axis} at {use.mean:.3g} +- {use.sd:.2g}, the flight alone says "
                f"{use.data:.3g}: {use.conflict:.1f} combined standard errors apart",
                f"the {name} of {axis} lies between the two, and its interval may hold neither",
                "leave --prior out, or correct [prior] in the card: it may be of other limits, vehicles or units",
                axis,
            )


def _errors(information: Array, free: Mask) -> Array:
    errors: Array = np.sqrt(np.maximum(np.diag(inverted(information, free)), 1e-300))
    return errors
