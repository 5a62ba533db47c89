"""The model file: JSON, versioned, no pickle, no NaN. Model -> file -> the same model."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.core.accuracy import Accuracy, AxisAccuracy, FlightEstimate, Inseparable, PriorUse, Scatter, Uncertainty
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import AXES
from rotorfit.core.laws import LEVELS_OF, structure_named
from rotorfit.core.limits import Conversion
from rotorfit.core.model import (
    STRUCTURE,
    Axis,
    Candidate,
    Combination,
    Evidence,
    Mode,
    Model,
    Plain,
    Predictor,
    Source,
    Spread,
    Weighed,
)
from rotorfit.core.physics import physics
from rotorfit.core.plain import plain_json
from rotorfit.files.cards import card_from_mapping


def uncertainty_from_mapping(raw: Mapping[str, Any]) -> Uncertainty:
    """The table from the plain types of a model file; KeyError or TypeError where it is not one."""
    return Uncertainty(**{**raw, "axes": {name: _axis_accuracy(axis) for name, axis in raw["axes"].items()}})


def _axis_accuracy(raw: Mapping[str, Any]) -> AxisAccuracy:
    scatter = raw["scatter"]
    return AxisAccuracy(
        coefficients={name: Accuracy(**one) for name, one in raw["coefficients"].items()},
        correlation=tuple(tuple(row) for row in raw["correlation"]),
        inseparable=tuple(_pair(one) for one in raw["inseparable"]),
        scatter=scatter and Scatter(**{**scatter, "flights": tuple(FlightEstimate(**f) for f in scatter["flights"])}),
    )


def _pair(raw: Mapping[str, Any]) -> Inseparable:
    return Inseparable(**{**raw, "pair": tuple(raw["pair"]), "ci95": raw["ci95"] and tuple(raw["ci95"])})


FORMAT = "rotorfit-model"

VERSION = 1


def save(model: Model, path: str | Path) -> None:
    """Writes a model file (JSON, without NaN)."""
    Path(path).write_text(json.dumps(to_mapping(model), indent=1, allow_nan=False) + "\n")


def load(path: str | Path) -> Model:
    """Reads a model file.

    Args:
        path: Of a file written by `save` or `rotorfit fit -o`.

    Returns:
        The model.

    Raises:
        ModelError: If it is missing, no model file, or of a newer version.
    """
    try:
        raw = plain_json(Path(path).read_bytes())
    except OSError as error:
        raise ModelError(
            f"{path}: cannot be read ({error.strerror}); give a model file written by `rotorfit fit -o`"
        ) from None
    except ValueError as error:
        raise ModelError(f"{path}: not a model file ({error}); give one written by `rotorfit fit -o`") from None
    return from_mapping(raw, str(path))


def is_model_file(path: str | Path) -> bool:
    """Whether a file is a model, by content."""
    with Path(path).open("rb") as file:
        return file.read(4096).lstrip()[:1] == b"{" and FORMAT.encode() in Path(path).read_bytes()[:4096]


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
        "flights": [asdict(flight) for flight in model.flights],
        "leave_one_out": None if model.leave_one_out is None else dict(model.leave_one_out),
        "uncertainty": model.uncertainty and asdict(model.uncertainty),
        "prior": None if model.prior is None else {name: asdict(use) for name, use in model.prior.items()},
    }


def _paper_mapping(model: Model) -> dict[str, Any]:
    """The paper's coefficients, and the noise of predictions by them where it is known: old models have none."""
    noise = {axis: dict(levels) for axis, levels in model.paper_noise.items()}
    return {"gamma": list(model.paper), **({"noise": noise} if noise else {})}


def _axis_mapping(axis: Axis) -> dict[str, Any]:
    """An axis as plain types; what only other structures have is left out where it is empty."""
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
    """A model from the plain types of a model file.

    Raises:
        ModelError: If it is not one, or of a newer version.
    """
    if not isinstance(raw, dict) or raw.get("format") != FORMAT:
        raise ModelError(f"{where}: not a rotorfit model; give a file written by `rotorfit fit -o`")
    if raw.get("version") != VERSION:
        raise ModelError(
            f"{where}: model version {raw.get('version')}, this one reads {VERSION}; use the rotorfit that wrote it"
        )
    try:
        return Model(
            card=card_from_mapping(raw["card"], where),
            structure=raw["structure"],
            method=raw["method"],
            axes={name: _axis(raw["axes"][name]) for name in AXES},
            covariance_names=tuple(raw["covariance"]["names"]),
            covariance=np.array(raw["covariance"]["matrix"], float).reshape((len(raw["covariance"]["names"]),) * 2),
            paper=tuple(raw["paper"]["gamma"]),
            findings=tuple(Finding(**finding) for finding in raw["findings"]),
            flights=tuple(_source(flight) for flight in raw["flights"]),
            rotorfit=raw["rotorfit"],
            uncertainty=uncertainty_from_mapping(raw["uncertainty"]) if raw.get("uncertainty") else None,
            prior=None if raw.get("prior") is None else {name: PriorUse(**use) for name, use in raw["prior"].items()},
            conversion=Conversion(**raw["conversion"]) if raw.get("conversion") else None,
            leave_one_out=raw.get("leave_one_out"),
            paper_noise=raw["paper"].get("noise", {}),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ModelError(f"{where}: damaged model file ({type(error).__name__}: {error}); fit it again") from None


def _axis(raw: Mapping[str, Any]) -> Axis:
    if raw["noise"] and set(raw["noise"]) not in [{*levels, "trim_variance"} for levels in LEVELS_OF.values()]:
        raise KeyError(f"noise has {', '.join(sorted(raw['noise']))}")
    return Axis(
        **{
            **raw,
            "ci95": {name: tuple(ends) for name, ends in raw["ci95"].items()},
            "trim": tuple(raw["trim"]),
            "predictor": Predictor(**raw["predictor"]) if raw["predictor"] else None,
            "ci95_flight": {name: tuple(ends) for name, ends in raw.get("ci95_flight", {}).items()},
            "combinations": {name: _combination(part) for name, part in raw["combinations"].items()},
            "spread": {name: _spread(part) for name, part in raw.get("spread", {}).items()},
            "evidence": tuple(Evidence(**part) for part in raw.get("evidence", ())),
            "modes": tuple(Mode(**mode) for mode in raw["modes"]),
            "profile": tuple((delay, value) for delay, value in raw["profile"]),
            "structure": structure_named(raw.get("structure", STRUCTURE)).name,
            "plain": _plain(raw["plain"]) if raw.get("plain") else None,
            "laws": tuple(_weighed(one) for one in raw.get("laws", ())),
            "candidates": tuple(_candidate(one) for one in raw.get("candidates", ())),
        }
    )


def _combination(raw: Mapping[str, Any]) -> Combination:
    own = raw.get("ci95_flight")
    return Combination(raw["value"], tuple(raw["ci95"]), None if own is None else tuple(own))


def _spread(raw: Mapping[str, Any]) -> Spread:
    each = tuple(None if one is None else tuple(one) for one in raw["each"])
    return Spread(**{**raw, "next_flight": tuple(raw["next_flight"]), "each": each})


def _plain(raw: Mapping[str, Any]) -> Plain:
    law = _weighed(raw["law"]) if raw.get("law") else None
    return Plain(**{**raw, "ci95": {name: tuple(ends) for name, ends in raw["ci95"].items()}, "law": law})


def _weighed(raw: Mapping[str, Any]) -> Weighed:
    return Weighed(
        **{
            **raw,
            "structure": structure_named(raw["structure"]).name,
            "predictor": Predictor(**raw["predictor"]),
            "correlation": tuple(tuple(row) for row in raw["correlation"]),
        }
    )


def _candidate(raw: Mapping[str, Any]) -> Candidate:
    changes = {name: tuple(raw[name]) if raw[name] else None for name in ("velocity_change", "position_change")}
    return Candidate(**{**raw, **changes})


def _source(raw: Mapping[str, Any]) -> Source:
    return Source(
        path=raw["path"],
        sha256=raw["sha256"],
        span=tuple(raw["span"]),
        notes=tuple(Note(**note) for note in raw["notes"]),
        axes=tuple(raw["axes"]),
    )
