"""Fit -> findings: evidence against the law of an axis."""

from collections.abc import Iterator

from rotorfit.core.finding import Finding
from rotorfit.core.laws import structure_named
from rotorfit.core.model import Axis, Predictor, first_order_beside
from rotorfit.estimation.judgement.omitted_terms import SLOW

MUCH_LIKELIER = 100.0
"""Decrease of the criterion from which on a law that `auto` rejected is reported.

On recorded flights, whose residuals no law makes quite white, rejected laws reach 65."""

STAMPS_ALONE = (
    "log commands by themselves, each with its own stamp, before you doubt the law: those of rows are late by another "
    "part of a row each time, which alone can look like this; then "
)

SMALLER = (
    "fit flights whose commands all have the size that the model is wanted for: smaller ones where large ones reach a "
    "limit of the vehicle, as of its tilt"
)
"""Remedy where small and large commands do not agree."""

LASTING = (
    f"fly commands of the length that the model is wanted for, of {3 * SLOW:.0f} s and more where final speeds matter: "
    "none of the structures has the integral part of a velocity loop behind a lag"
)
"""Remedy where commands that last are answered otherwise than short ones."""


def law_findings(name: str, axis: Axis, stamped: bool = True) -> Iterator[Finding]:
    """Findings of the tests of an axis's law, and of the choice among laws.

    The intervals include the doubt, or the law is refuted, or another one was much likelier and was rejected.

    Args:
        name: Name of the axis.
        axis: As fitted.
        stamped: Whether commands bear their own stamps.
    """
    yield from _rejected(name, axis)
    beside = contradicted(axis)
    told = "; ".join(f"{one.strength} (p = {one.p_value:.1g})" for one in axis.evidence)
    if beside:
        under = f"its input is {axis.predictor.input:.3g}" if axis.predictor else f"the {name} command explains nothing"
        against = f"under it {under}; with a delay alone, which is likelier, the input is {beside.input:.3g}"
        yield Finding(
            "law_refuted",
            "warning",
            f"{name} does not obey {axis.structure}: {'; '.join(filter(None, (against, told)))}",
            f"{axis.structure} has no coefficients of {name}; card and excitation are not to blame for it",
            "fit without --structure, or with --structure auto",
            name,
        )
        return
    if not axis.evidence:
        return
    chosen = any(one.chosen for one in axis.candidates)  # by `auto`, which would choose it again
    law = _law(axis)
    refuted = [part for part, status in axis.status.items() if status == "refuted"]
    if refuted:
        stated = "its interval says" if len(refuted) == 1 else "their intervals say"
        yield Finding(
            "law_refuted",
            "warning",
            f"{name} does not obey {axis.structure}: {told}",
            f"{', '.join(refuted)} of {name} would differ on another flight by more than {stated}",
            (
                "no law that --structure auto tries does better: "
                if chosen
                else f"fit with --structure {law}, or " * bool(law)
            )
            + _flights(axis, "fly commands of the size and speed that the model is wanted for")
            + "; predictions of like motion may still be good: see validate",
            name,
        )
        return
    yield Finding(
        "law_doubted",
        "info",
        f"{name} does not quite obey {axis.structure}: {told}",
        f"the intervals of {name} are that much wider: they allow for what the law leaves out",
        ("" if stamped else STAMPS_ALONE)
        + ("" if chosen or not law else f"fit with --structure {law}; ")
        + _flights(axis, "commands of several sizes and speeds in one flight show what is missing"),
        name,
    )


def _law(axis: Axis) -> str:
    """The law to fit next: the one that has what is missing, if it is known; empty where none of the structures has."""
    tests = {one.test for one in axis.evidence}
    if structure_named(axis.structure).limited:
        return ""
    if "bound" in tests:
        return "limited_acceleration"
    if "drag" in tests and "size" not in tests:
        return "quadratic_drag"
    return "" if "twice" in tests else "auto"  # commands that saturate look like drag, too: `auto` tries both


def _flights(axis: Axis, otherwise: str) -> str:
    """The flights that help: smaller commands, longer ones, or otherwise others."""
    if _by_size(axis):
        return SMALLER
    return LASTING if any(one.test == "slow" for one in axis.evidence) else otherwise


def _by_size(axis: Axis) -> bool:
    """Whether small and large commands give different coefficients, or large ones meet a limit."""
    return any(one.test in ("size", "bound", "jerk") for one in axis.evidence)


def with_size(axis: Axis, remedy: str) -> str:
    """The remedy of another finding for the doubts of a law, after the one for commands of different sizes."""
    return f"{SMALLER}; {remedy}" if _by_size(axis) else remedy


def contradicted(axis: Axis) -> Predictor | None:
    """The first-order law with a delay, where under the axis's own law the commands explain nothing, or the opposite.

    None where its own law does not contradict it, or is not refuted.
    """
    beside = first_order_beside(axis)
    if beside is None or axis.status["input"] != "refuted":
        return None
    return beside if axis.predictor is None or axis.predictor.input * beside.input < 0 else None


def _rejected(name: str, axis: Axis) -> Iterator[Finding]:
    """The likeliest law that `auto` rejected, if it is much likelier than the one that it chose."""
    chosen = next((one for one in axis.candidates if one.chosen), None)
    if chosen is None:
        return
    likeliest = min(axis.candidates, key=lambda one: one.bic)
    if likeliest.bic > chosen.bic - MUCH_LIKELIER:
        return
    yield Finding(
        "likelier_law_rejected",
        "warning",
        f"the data of {name} are much likelier under {likeliest.structure} than under {chosen.structure}, which was "
        f"chosen: the criterion is lower by {chosen.bic - likeliest.bic:.0f}, where 10 is very strong evidence; "
        f"{likeliest.structure} was {likeliest.verdict}",
        f"the intervals of {name} hold as far as {chosen.structure} does; what it leaves out may be in them",
        f"fit with --structure {likeliest.structure}, too, and compare; a longer flight, or several, decides by its "
        "predictions",
        name,
    )
