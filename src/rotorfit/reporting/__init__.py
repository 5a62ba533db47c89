"""Views -> one HTML page to send on, and figures for a paper."""

from collections.abc import Sequence
from pathlib import Path

from rotorfit.assessment.case import Case
from rotorfit.core.flight_data import Flight
from rotorfit.core.model import Model
from rotorfit.core.results import Validation

__all__ = ["write_cases", "write_figures", "write_report"]


def write_report(
    model: Model,
    training: Sequence[Flight],
    validation: Validation,
    flights: Sequence[Flight],
    path: Path,
    model_path: str = "model.json",
) -> None:
    """Writes one self-contained HTML page: verdict, evidence, what to fly next, coefficients, findings, repairs.

    The page asks nothing of the network, works from a mail attachment, prints, and follows the reader's light or dark
    setting. Charts of flights zoom where scripts may run and are pictures where they may not.

    Args:
        model: With its findings.
        training: The flights that it was fitted to; empty where they are not at hand.
        validation: Its scores; without flights where there are none.
        flights: The flights of the scores, in their order; empty where they are not at hand.
        path: Of the page; overwritten.
        model_path: Of the model file, for the lines to type.
    """
    write_cases([Case(model_path, model, tuple(training), validation, tuple(flights))], path)


def write_cases(cases: Sequence[Case], path: Path) -> None:
    """The same for one model or for several on the same flights, side by side.

    Args:
        cases: The models with their proofs, see `case.cases_of`.
        path: Of the page; overwritten.
    """
    from rotorfit.reporting.page import page

    # A path of undecodable bytes holds lone surrogates, which UTF-8 has no place for.
    path.write_bytes(page(cases).encode("utf-8", "replace"))


def write_figures(
    model: Model, training: Sequence[Flight], validation: Validation, flights: Sequence[Flight], directory: Path
) -> list[Path]:
    """Writes figures for a paper, each as PNG and PDF; those without content are left out.

    Among them is the layout of the paper's Figure 4: measured against modelled acceleration in world axes for x, y, z
    and yaw, each on the validation flight that moves it most.

    Args:
        model: With its findings.
        training: The flights that it was fitted to; they stand in where there are no validation flights.
        validation: Its scores.
        flights: The flights of the scores, in their order.
        directory: Where to write; made where it is missing.

    Returns:
        The files written.
    """
    from rotorfit.reporting.figures import figures

    return figures(model, training, validation, flights, directory)
