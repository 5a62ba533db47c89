"""The model file: versioned JSON, no pickle, no NaN. A model survives writing and reading unchanged; all is checked."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.core.accuracy import PriorUse, Uncertainty
from rotorfit.core.errors import ModelError, RotorfitError, nearest
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.laws import LEVELS_OF, Structure, structure_named
from rotorfit.core.limits import Conversion
from rotorfit.core.model import COEFFICIENTS, Axis, Interval, Model, Predictor, Source, Weighed
from rotorfit.core.physics import physics
from rotorfit.core.plain import place_of, plain_json, shown, text_of
from rotorfit.core.results import FlightScores, LeftOut, PairedTest
from rotorfit.core.writing import write_result
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.mistaken import kind_of, mistaken
from rotorfit.files.schema import structured

FORMAT = "rotorfit-model"

VERSION = 1


def save(model: Model, path: str | Path) -> Path | None:
    """Writes a model file (JSON, without NaN) and returns the path where a replaced file is kept, or None.

    Raises:
        LogError: Its folder is missing.
        OSError: The file cannot be written.
    """
    return write_result(path, json.dumps(to_mapping(model), indent=1, allow_nan=False) + "\n")


def lost_axes(kept: Path | None, model: Model) -> tuple[str, ...]:
    """Axes that the replaced, kept model has numbers for and this one has not; empty where none was kept."""
    if kept is None:
        return ()
    try:
        earlier = load(kept)
    except RotorfitError:  # damaged, or of another version: it is kept all the same
        return ()
    return tuple(axis for axis in AXES if earlier.axes[axis].predictor and not model.axes[axis].predictor)


def load(path: str | Path) -> Model:
    """Reads a model file.

    Args:
        path: A file written by `save` or `rotorfit fit -o`.

    Returns:
        The model.

    Raises:
        ModelError: The file is missing, damaged, not a model file, or of another version.
    """
    try:
        raw = plain_json(text_of(Path(path)))
    except OSError as error:
        raise ModelError(
            mistaken(path, "model")
            or f"{path}: cannot be read ({error.strerror}); give a model file written by `rotorfit fit -o`"
        ) from None
    except ValueError as error:
        if kind_of(Path(path)) == "model":
            raise ModelError(f"{path}: a model file that is cut short or damaged ({error}); fit it again") from None
        raise ModelError(
            mistaken(path, "model")
            or f"{path}: not a model file, or a damaged one ({error}); `rotorfit fit -o` and `track -o` write them"
        ) from None
    return from_mapping(raw, str(path))


def is_model_file(path: str | Path) -> bool:
    """Whether a file is a model, by its content.

    Raises:
        OSError: The file cannot be read.
    """
    with Path(path).open("rb") as file:
        head = file.read(4096)
    return head.lstrip()[:1] == b"{" and FORMAT.encode() in head


def to_mapping(model: Model) -> dict[str, Any]:
    """The model as plain JSON types."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "rotorfit": model.rotorfit,
        "card": dict(model.card.raw),
        "structure": model.structure,
        "method": model.method,
        "gamma": list(model.gamma),
        "axes": {name: _axis_mapping(axis) for name, axis in model.axes.items()},
        "covariance": {"names": list(model.covariance_names), "matrix": model.covariance.tolist()},
        "paper": _paper_mapping(model),
        "physics": {name: {key: asdict(part) for key, part in parts.items()} for name, parts in physics(model).items()},
        "conversion": asdict(model.conversion) if model.conversion else None,
        "findings": [asdict(finding) for finding in model.findings],
        "flights": [_source_mapping(flight) for flight in model.flights],
        "leave_one_out": None if model.leave_one_out is None else dict(model.leave_one_out),
        "uncertainty": model.uncertainty and asdict(model.uncertainty),
        "prior": None if model.prior is None else {name: asdict(use) for name, use in model.prior.items()},
    }


def _paper_mapping(model: Model) -> dict[str, Any]:
    """The paper's coefficients, with the noise of their predictions where it is known: old models have none."""
    noise = {axis: dict(levels) for axis, levels in model.paper_noise.items()}
    return {"gamma": list(model.paper), **({"noise": noise} if noise else {})}


def _source_mapping(source: Source) -> dict[str, Any]:
    """A flight as plain types; old models have no landmarks, rate of the poses or largest commands."""
    raw = asdict(source)
    for name in ("landmarks", "pose_rate", "commanded"):
        if not raw[name]:
            del raw[name]
    return raw


def _axis_mapping(axis: Axis) -> dict[str, Any]:
    """An axis as plain types; what only other structures use is omitted where it is empty."""
    raw = asdict(axis)
    if raw["predictor"] and not raw["predictor"]["extra"]:
        del raw["predictor"]["extra"]
    for name in ("extra", "plain", "laws", "lag_prior", "candidates", "samples", "ci95_flight", "spread", "evidence"):
        if raw[name] in (None, {}, ()):
            del raw[name]
    for part in raw["combinations"].values():
        if part["ci95_flight"] is None:
            del part["ci95_flight"]
    return raw


def from_mapping(raw: Any, where: str) -> Model:
    """Builds a model from the plain types of a model file.

    Raises:
        ModelError: Not a model, damaged, or of another version.
    """
    if not isinstance(raw, dict) or raw.get("format") != FORMAT:
        raise ModelError(f"{where}: not a rotorfit model; give a file written by `rotorfit fit -o`")
    if raw.get("version") != VERSION:
        raise ModelError(
            f"{where}: model version {shown(raw.get('version'))}, this one reads {VERSION}; "
            "use the rotorfit that wrote it"
        )
    try:
        return _model(structured(raw, _ModelFile), raw, where)
    except ValueError as error:
        raise ModelError(f"{where}: damaged model file: {error}; fit it again") from None


@dataclass(frozen=True)
class _Covariance:
    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class _Paper:
    gamma: tuple[float | None, ...]
    noise: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Scored:
    flights: tuple[FlightScores, ...]


@dataclass(frozen=True)
class _LeaveOneOut:
    """As written by `leave_one_out.leave_one_out_mapping`, which belongs to a layer above this module."""

    flights: tuple[FlightScores, ...]
    baselines: Mapping[str, _Scored]
    paired: tuple[PairedTest, ...]
    spread: tuple[LeftOut, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _ModelFile:
    """Content of a model file; `gamma` and `physics` are for readers of the file and follow from the rest.

    Fields with a default are those that earlier versions did not write.
    """

    format: str
    version: int
    rotorfit: str
    card: Mapping[str, Any]
    structure: str
    method: str
    gamma: Any
    axes: Mapping[str, Axis]
    covariance: _Covariance
    paper: _Paper
    findings: tuple[Finding, ...]
    flights: tuple[Source, ...]
    physics: Any = None
    conversion: Conversion | None = None
    leave_one_out: _LeaveOneOut | None = None
    uncertainty: Uncertainty | None = None
    prior: Mapping[str, PriorUse] | None = None


def _model(read: _ModelFile, raw: Mapping[str, Any], where: str) -> Model:
    """Builds the model from a file whose types are right.

    Raises:
        ValueError: A value is impossible; the error names its location.
    """
    _same("axes", read.axes, AXES)
    for name, axis in read.axes.items():
        _check_axis(axis, ("axes", name))
    names, matrix = read.covariance.names, read.covariance.matrix
    if len(matrix) != len(names) or any(len(row) != len(names) for row in matrix):
        raise ValueError(f"covariance.matrix: must have {len(names)} rows of {len(names)}")
    if len(read.paper.gamma) != 2 * len(AXES):
        raise ValueError(f"paper.gamma: must be a list of {2 * len(AXES)}")
    for name, noise in read.paper.noise.items():
        _check_noise(noise, ("paper", "noise", name))
    for i, flight in enumerate(read.flights):
        if flight.pose_rate is not None and flight.pose_rate <= 0:
            raise ValueError(f"{place_of(('flights', i, 'pose_rate'))}: must be above 0, not {flight.pose_rate:g}")
        for name, largest in flight.commanded.items():
            if name not in AXES or not largest > 0:
                place = place_of(("flights", i, "commanded", name))
                raise ValueError(f"{place}: must be an axis with its largest command, above 0, not {largest:g}")
    return Model(
        card=card_from_mapping(read.card, where),
        structure=read.structure,
        method=read.method,
        axes={name: read.axes[name] for name in AXES},
        covariance_names=names,
        covariance=np.array(matrix, float).reshape(len(names), len(names)),
        paper=read.paper.gamma,
        findings=read.findings,
        flights=read.flights,
        rotorfit=read.rotorfit,
        uncertainty=read.uncertainty,
        prior=read.prior,
        conversion=read.conversion,
        leave_one_out=raw.get("leave_one_out"),
        paper_noise=read.paper.noise,
    )


def _same(place: str, given: Mapping[str, Any], known: tuple[str, ...]) -> None:
    if set(given) != set(known):
        raise ValueError(f"{place}: must be {', '.join(known)}, not {', '.join(given) or 'empty'}")


def _check_axis(axis: Axis, place: tuple[str, ...]) -> None:
    """Checks what the types alone do not guarantee for an axis."""
    law = _law(axis.structure, (*place, "structure"))
    known = {*COEFFICIENTS, *(extra.name for extra in law.extras)}
    _check_published(axis, known, place)
    _check_noise(axis.noise, (*place, "noise"))
    if axis.predictor:
        _check_predictor(axis.predictor, law, (*place, "predictor"))
    if axis.plain:
        _check_published(axis.plain, set(COEFFICIENTS), (*place, "plain"))
    weighed: list[tuple[tuple[str | int, ...], Weighed]]
    weighed = [((*place, "laws", i), one) for i, one in enumerate(axis.laws)]
    if axis.plain and axis.plain.law:
        weighed.append(((*place, "plain", "law"), axis.plain.law))
    for at, one in weighed:
        _check_predictor(one.predictor, _law(one.structure, (*at, "structure")), (*at, "predictor"))
        if {len(one.stderr)} != {len(one.correlation), *map(len, one.correlation)}:
            raise ValueError(f"{place_of((*at, 'correlation'))}: must have {len(one.stderr)} rows of as many")
    for name, part in axis.combinations.items():
        _check_interval(part.ci95, (*place, "combinations", name, "ci95"))


def _law(name: str, place: tuple[str | int, ...]) -> Structure:
    try:
        return structure_named(name)
    except ModelError as error:
        raise ValueError(f"{place_of(place)}: {error}") from None


def _check_published(known: Any, names: set[str], place: tuple[str, ...]) -> None:
    """Checks that errors, intervals and statuses name coefficients of the law, and all of the first-order law's."""
    for part in ("stderr", "ci95", "status", "ci95_flight", "extra"):
        given = getattr(known, part, {})
        for name in given:
            if name not in names:
                raise ValueError(f"{place_of((*place, part, name))}: unknown key{nearest(name, names)}")
        if part in ("stderr", "ci95", "status") and (missing := set(COEFFICIENTS) - set(given)):
            raise ValueError(f"{place_of((*place, part, min(missing)))}: is missing")
    for name, error in known.stderr.items():
        if error is not None and error < 0:
            raise ValueError(f"{place_of((*place, 'stderr', name))}: must not be negative, not {error:g}")
    for name, ends in known.ci95.items():
        _check_interval(ends, (*place, "ci95", name))


def _check_interval(ends: Interval, place: tuple[str, ...]) -> None:
    low, high = ends
    if low is not None and high is not None and low > high:
        raise ValueError(f"{place_of(place)}: {low:g} to {high:g} is not an interval")


def _check_predictor(point: Predictor, law: Structure, place: tuple[str | int, ...]) -> None:
    _same(place_of((*place, "extra")), point.extra, tuple(extra.name for extra in law.extras))
    for name, bound in _BOUNDS.items():
        if abs(getattr(point, name)) > bound:
            raise ValueError(f"{place_of((*place, name))}: {getattr(point, name):g} is beyond {bound:g}")


_BOUNDS = {"input": 1e6, "damping": 1e4, "delay": 60.0}
"""Magnitudes that no vehicle exceeds; delay in s, damping in 1/s."""


def _check_noise(noise: Mapping[str, float], place: tuple[str, ...]) -> None:
    if noise and set(noise) not in [{*levels, "trim_variance"} for levels in LEVELS_OF.values()]:
        raise ValueError(f"{place_of(place)}: has {', '.join(sorted(noise))}")
    for name, value in noise.items():
        if value < 0:
            raise ValueError(f"{place_of((*place, name))}: must not be negative, not {value:g}")
