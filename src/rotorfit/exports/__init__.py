"""Model to code and parameters that a controller, an estimator or a simulator takes.

In goes a Model, and a Validation where there is one; out comes the text of one file in the target's own language, with
the numbers, where they are from and what they are valid for.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from rotorfit.core.errors import ExportError
from rotorfit.core.writing import write_whole
from rotorfit.exports.formats import FORMATS, Format
from rotorfit.version import __version__

if TYPE_CHECKING:
    from rotorfit.core.flight_data import Flight
    from rotorfit.core.model import Model
    from rotorfit.core.results import Validation

__all__ = ["FORMATS", "MARK", "Export", "Format", "export"]

MARK = b"written by rotorfit export"
"""What the first bytes of every export hold, in small letters."""


@dataclass(frozen=True)
class Export:
    """A model in another form.

    Attributes:
        format: Its name.
        name: Of the vehicle in the file.
        axes: The axes that it has numbers for.
        notes: What was left out, rounded or scaled.
        model: The model whose simulation the file repeats: left-out axes without a predictor, gains per command of the
            export, delays as exported.
        text: The whole file.
        kept: Where the file that it replaced is; None where there was none.
    """

    format: str
    name: str
    axes: tuple[str, ...]
    notes: tuple[str, ...]
    model: "Model" = field(repr=False)
    text: str = field(repr=False)
    kept: Path | None = field(default=None, repr=False)


def export(
    model: "Model | str | Path",
    to: str,
    path: str | Path | None = None,
    *,
    dt: float = 0.02,
    predictor: bool = False,
    physical: bool = False,
    round_delay: bool = False,
    training: "Sequence[Flight]" = (),
    validation: "Validation | None" = None,
    name: str | None = None,
) -> Export:
    """Writes a model in the form that a controller, an estimator or a simulator takes.

    Axes whose coefficients the data cannot tell are left out: there the vehicle keeps its velocity. The file says so.

    Args:
        model: A model, or the path of a model file.
        to: Name of a format, a key of `FORMATS`.
        path: Where to write, overwritten; None writes nothing.
        dt: Sample period [s] of what needs one when it is written: the C header, and delays that are rounded. The other
            formats take it when they are used.
        predictor: Export axes that the data cannot tell, too, by the likelihood's own point, which predicts best.
        physical: Take commands in SI (rad, m/s, rad/s) where the card makes them fractions of a limit.
        round_delay: Round delays to whole samples of dt; by how much is written down.
        training: The flights of the fit, for the speeds at which the model was trained.
        validation: Scores on other flights, for the header; else those of the model's own proof.
        name: Of the vehicle in the file; default: that of the path, else of the format.

    Raises:
        ExportError: Unknown format, a structure that the format cannot hold, no axis left, or a MATLAB file whose name
            is no name of a function.
        ModelError: The model file cannot be read.

    Source: the laws of `structure`; commands act after the delay to the fraction of a sample.
    """
    from rotorfit.exports.header import header
    from rotorfit.exports.subject import subject_of
    from rotorfit.exports.validity import scores, trained_on
    from rotorfit.exports.writing import check, render, summary_of

    form = _format_named(to)
    known, origin, digest = _identified(model)
    wanted = name or (Path(path).stem if path else f"{known.card.name} model")
    subject = subject_of(
        known, wanted, origin, digest, dt=dt, predictor=predictor, physical=physical, round_delay=round_delay
    )
    check(subject, to, form)
    if path and form.named and Path(path).stem != subject.name:
        raise ExportError(
            f"{path}: {to} wants the file to have the name of its function; call it {subject.name}{form.suffix}"
        )
    mark = f"Written by rotorfit export {__version__}, format {to}."
    lines = header(
        subject, summary_of(subject, form), trained_on(training), scores(known, validation, subject.axes), mark
    )
    text, kept = render(subject, to, form, lines), None
    if path:
        kept = write_whole(path, text)
    return Export(to, subject.name, subject.axes, subject.notes, subject.model, text, kept)


def _format_named(to: str) -> Format:
    if to not in FORMATS:
        raise ExportError(f"no such format: {to!r}; formats are {', '.join(FORMATS)}")
    return FORMATS[to]


def _identified(model: "Model | str | Path") -> "tuple[Model, str, str]":
    """The model, where it is from, and the hash of its file; of a model in memory, that which `save` would write."""
    from rotorfit.files.models import load, to_mapping

    if isinstance(model, str | Path):
        loaded = load(model)
        return loaded, Path(model).name, hashlib.sha256(Path(model).read_bytes()).hexdigest()
    text = json.dumps(to_mapping(model), indent=1, allow_nan=False) + "\n"
    return model, "a model in memory", hashlib.sha256(text.encode()).hexdigest()
