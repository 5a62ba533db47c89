"""The worker: a fit or comparison in a process of its own, which can be cancelled or die without affecting the page.

    python -m rotorfit.app.web.worker WORKSPACE FIT

It reads `request.json` and `card.toml` in the fit's folder, reports progress as lines of JSON on standard output, and
writes `model.json`, `trained.json` (for exports), `validation.json`, `result.json` and `report.html`. It ends with its
standard input, so it does not outlive the studio.
"""

import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from threading import Thread
from typing import Any

from rotorfit.app.comparison import compare_models, comparison_mapping
from rotorfit.app.web.wire import compared_mapping, result_mapping
from rotorfit.app.web.workspace import WorkspaceError
from rotorfit.app.workflows import fit_logs, usable_logs, validate_logs
from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import evidence_of
from rotorfit.assessment.validation import BASELINES, to_mapping
from rotorfit.core.errors import RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.plain import plain_json, text_of
from rotorfit.core.progress import Progress
from rotorfit.core.results import CURVE, Validation
from rotorfit.core.writing import write_whole
from rotorfit.exports.validity import trained_on
from rotorfit.files.cards import load_card
from rotorfit.files.log_span import LogSpan
from rotorfit.files.models import load, save
from rotorfit.reporting.page import page

FITTING, PROVING = 0.75, 0.93
"""Fractions of the progress at which the fit and the validation end."""

UNPROVEN = Validation((), dict.fromkeys(BASELINES, ()), dict.fromkeys(("model", *BASELINES), ()))
"""The validation on no flights."""

_PLACE = re.compile(r"logs/\d+/")
"""What is left out of the report, so that its command lines run where the user keeps the logs."""


def run(workspace: Path, fit_id: str, progress: Progress) -> str:
    """Carries out the request in a fit's folder.

    Returns:
        One line about the result.
    """
    os.chdir(workspace)  # so that models and reports name logs by short paths
    folder = Path("fits") / fit_id
    try:
        request = plain_json(text_of(folder / "request.json"))
    except ValueError as error:
        raise WorkspaceError(f"what was asked for is damaged ({error}); start the fit again") from None
    names = request["names"]
    carry_out = _compare if request["kind"] == "compare" else _fit
    try:
        line = carry_out(folder, request, lambda fraction, text: progress(fraction, with_names(text, names)))
    except RotorfitError as error:
        raise RotorfitError(with_names(str(error), names)) from None
    return str(with_names(line, names))


def _fit(folder: Path, request: dict[str, Any], progress: Progress) -> str:
    card = load_card(str(folder / "card.toml"))
    training, tested = (
        [LogSpan(path, (start, end)) for path, start, end in request[role]] for role in ("train", "validate")
    )
    fitted = fit_logs(
        training,
        card,
        request["method"],
        request["axes"],
        lambda fraction, text: progress(FITTING * fraction, text),
        request["structure"],
        request["uncertainty"],
    )
    save(fitted.model, folder / "model.json")
    write_whole(folder / "trained.json", json.dumps(trained_on(fitted.flights)))

    def proving(fraction: float, text: str) -> None:
        progress(FITTING + (PROVING - FITTING) * fraction, f"validating: {text}")

    validation: Validation = UNPROVEN
    flights: tuple[Flight, ...] = ()
    left: list[str] = []
    if tested:
        try:
            validation, flights = validate_logs(fitted.model, tested, card, CURVE, proving, fitted.flights)
        except RotorfitError:
            tested, left = usable_logs([fitted.model], tested, card)
            if tested:
                validation, flights = validate_logs(fitted.model, tested, card, CURVE, proving, fitted.flights)
    if tested:
        write_whole(folder / "validation.json", json.dumps(to_mapping(validation), indent=1, allow_nan=False))
    progress(PROVING, "drawing")
    (evidence,) = evidence_of([Case(f"model-{folder.name}.json", fitted.model, fitted.flights, validation, flights)])
    result = result_mapping(evidence)
    _write_result(folder, with_names({**result, "left_out": left}, request["names"]))
    progress(PROVING + 0.02, "writing the report")
    write_whole(folder / "report.html", _PLACE.sub("", page([evidence])))
    return f"{result['horizon']:g} s ahead: {result['headline']}{_without(left)}"


def _compare(folder: Path, request: dict[str, Any], progress: Progress) -> str:
    paths = [f"fits/{fit}/model.json" for fit in request["models"]]
    models = [load(path) for path in paths]
    spans = [LogSpan(path, (start, end)) for path, start, end in request["validate"]]
    left: list[str] = []
    try:
        comparison = compare_models(paths, models, spans, progress=progress)
    except RotorfitError:
        spans, left = usable_logs(models, spans)
        if not spans:
            raise
        comparison = compare_models(paths, models, spans, progress=progress)
    result = compared_mapping(comparison, request["models"], models, comparison_mapping(comparison))
    _write_result(folder, with_names({**result, "left_out": left}, request["names"]))
    return f"{len(paths)} models on {len(spans)} stretches{_without(left)}"


def _without(left: list[str]) -> str:
    """The end of the line about the result: what was left out."""
    return f"; left out: {' / '.join(left)}" if left else ""


def _write_result(folder: Path, result: dict[str, Any]) -> None:
    """Writes the result for the page."""
    write_whole(folder / "result.json", json.dumps(result, allow_nan=False))


def with_names(told: Any, names: Mapping[str, str]) -> Any:
    """Texts, or JSON with texts, in which each path among `names` is the name that the user gave the log."""
    if isinstance(told, dict):
        return {key: with_names(one, names) for key, one in told.items()}
    if isinstance(told, list | tuple):
        return [with_names(one, names) for one in told]
    if isinstance(told, str):
        for path, name in names.items():
            told = told.replace(path, name)
    return told


def main(workspace: str, fit_id: str) -> int:
    """Runs the worker; a known error is reported in one line, a bug prints its traceback on standard error."""
    os.nice(5)  # the page comes first
    Thread(target=_end_with_the_studio, daemon=True).start()
    try:
        text = run(Path(workspace), fit_id, lambda fraction, text: _say(fraction=fraction, text=text))
    except RotorfitError as error:
        _say(error=" ".join(str(error).split()))
        return 1
    except OSError as error:
        _say(error=f"{error.filename or workspace}: {error.strerror}; check the room on the disk")
        return 1
    _say(done=text)
    return 0


def _say(**what: Any) -> None:
    print(json.dumps(what), flush=True)


def _end_with_the_studio() -> None:
    os.read(0, 1)  # not sys.stdin, whose lock would block the exit
    os._exit(3)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
