"""Exports: from a model to code and parameters for a controller, an estimator or a simulator.

A Model goes in; the text of one file in the target's own language comes out, with the numbers, their origin and the
range in which they are valid.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rotorfit.core.errors import ExportError
from rotorfit.core.writing import write_result
from rotorfit.exports.formats import FORMATS, Format
from rotorfit.version import __version__

if TYPE_CHECKING:
    from rotorfit.core.model import Model
    from rotorfit.core.results import Validation

__all__ = ["FORMATS", "MARK", "Export", "Format", "export"]

MARK = b"written by rotorfit export"
"""Text in the first bytes of every export, in lower case."""


@dataclass(frozen=True)
class Export:
    """An exported model.

    Attributes:
        format: Name of the format.
        name: Name of the vehicle in the file.
        axes: The axes that it has numbers for.
        notes: What was left out, rounded or scaled.
        model: The model whose simulation the file reproduces: axes that are left out have no predictor, gains are per
            command of the export, delays are as exported.
        text: The whole file.
        kept: Path at which a replaced file is kept; None if there was none, or nothing was written.
    """

    format: str
    name: str
    axes: tuple[str, ...]
    notes: tuple[str, ...]
    model: "Model" = field(repr=False)
    text: str = field(repr=False)
    kept: Path | None = field(default=None, repr=False)


IMPORTED = ("math", "itertools", "numpy", "scipy", "control", "casadi", "acados_template", "jax", "rotorpy")
"""Modules that exported Python imports, which a file of the same name beside it would hide."""


def export(
    model: "Model | str | Path",
    to: str,
    path: str | Path | None = None,
    *,
    dt: float = 0.02,
    predictor: bool = False,
    physical: bool = False,
    round_delay: bool = False,
    trained: Mapping[str, Sequence[float]] = MappingProxyType({}),
    score: "Callable[[Model], Validation] | None" = None,
    validation: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> Export:
    """Exports a model for a controller, an estimator or a simulator.

    Axes that are not identifiable are left out: there the vehicle keeps its velocity. The file says so.

    Args:
        model: A model, or the path of a model file.
        to: Name of a format, a key of `FORMATS`.
        path: Path to write; an existing file is replaced and kept, see `Export.kept`. None writes nothing.
        dt: Sample period of the C header, and of rounded delays [s]. The other formats take it when they are used.
        predictor: Whether to also export axes that are not identifiable, at the likelihood's point, which predicts
            best.
        physical: Whether commands are in SI units (rad, m/s, rad/s) where the card has fractions of a limit.
        round_delay: Whether to round delays to whole samples of dt; the file states by how much.
        trained: Speeds and commands of the flights of the fit, as `validity.trained_on` gives them.
        score: Scores the exported numbers on other flights.
        validation: Without `score`, scores of the model as it is, as `assessment.validation.to_mapping` has them; None
            for its own leave-one-out. They do not hold for an axis that is exported with another delay.
        name: Name of the vehicle in the file; by default that of the path, else of the card.

    Returns:
        The export, with its text and notes.

    Raises:
        ExportError: The format is unknown, it cannot hold a structure of the model, no axis is left, or the name of a
            MATLAB file is not that of its function.
        ModelError: The model file cannot be read.

    Source: the laws of `core.laws`; commands act after the delay, to a fraction of a sample.
    """
    from rotorfit.exports.header import header
    from rotorfit.exports.subject import subject_of
    from rotorfit.exports.validity import scores
    from rotorfit.exports.writing import check, render, summary_of

    form = _format_named(to)
    known, origin, digest = _identified(model)
    wanted = name or (Path(path).stem if path else f"{known.card.name} model")
    subject = subject_of(
        known, wanted, origin, digest, dt=dt, predictor=predictor, physical=physical, round_delay=round_delay
    )
    check(subject, to, form)
    if path and form.suffix == ".py" and Path(path).stem in IMPORTED:
        raise ExportError(
            f"{path}: {to} imports a module of this name; choose another, such as {subject.name}_model.py"
        )
    if path and form.named and Path(path).stem != subject.name:
        raise ExportError(f"{path}: a {to} file must be named after its function; call it {subject.name}{form.suffix}")
    mark = f"Written by rotorfit export {__version__}, format {to}."
    if score:
        from rotorfit.assessment.validation import to_mapping

        errors = scores(to_mapping(score(subject.scored)), subject.axes)
    else:
        errors = scores(validation or known.leave_one_out, subject.axes, subject.changed)
    lines = header(subject, summary_of(subject, form), trained, errors, mark)
    text, kept = render(subject, to, form, lines), None
    if path:
        kept = write_result(path, text)
    return Export(to, subject.name, subject.axes, subject.notes, subject.model, text, kept)


def _format_named(to: str) -> Format:
    if to not in FORMATS:
        raise ExportError(f"no such format: {to!r}; formats are {', '.join(FORMATS)}")
    return FORMATS[to]


def _identified(model: "Model | str | Path") -> "tuple[Model, str, str]":
    """The model, its origin, and the hash of its file, or of the file that `save` would write for one in memory."""
    from rotorfit.files.models import load, to_mapping

    if isinstance(model, str | Path):
        loaded = load(model)
        return loaded, Path(model).name, hashlib.sha256(Path(model).read_bytes()).hexdigest()
    text = json.dumps(to_mapping(model), indent=1, allow_nan=False) + "\n"
    return model, "a model in memory", hashlib.sha256(text.encode()).hexdigest()
