"""The gains file: TOML, or YAML by its suffix, with units, margins and the origin of the numbers."""

import math
from collections.abc import Mapping
from io import StringIO
from pathlib import Path
from typing import Any

from rotorfit.control.control_law import AxisLaw
from rotorfit.control.tuning import AxisTuning, Tuning
from rotorfit.core.errors import ModelError
from rotorfit.core.limits import WORLD_COMMANDS, command_of
from rotorfit.core.model import Model
from rotorfit.core.plain import check_finite, plain_toml, shown
from rotorfit.core.writing import check_folder, write_whole
from rotorfit.files.mistaken import mistaken
from rotorfit.version import __version__

FORMAT = "rotorfit-gains"

VERSION = 1

GAINS_MARK = b"rotorfit-gains"
"""Text in the first bytes of a gains file."""

SUFFIXES = (".toml", ".yaml", ".yml")

PREDICTED = "u = (r'' + b r' + K (r - p) + D (r' - v) - d) / input; r, p, v, d at the instant at which u acts"

LAWS: Mapping[str, str] = {
    "predictor": PREDICTED,
    "lqr": PREDICTED,
    "linearising": "u = (r'' + b r' + K e + D e' + I int e) / input; e = r - p of the last pose, e' its filtered rate; "
    "r'' and r' at the instant at which u acts",
}
"""Meaning of the numbers; docs/control.md has the equations."""

SYMBOLS: Mapping[str, str] = {
    "u": "command, cut to -full_scale .. full_scale, held until the next",
    "r": "reference, with its derivatives r' and r''",
    "p": "position",
    "v": "velocity",
    "d": "slow acceleration that is not commanded: wind, trim, what input and damping miss",
    "b": "damping",
    "K": "stiffness",
    "D": "rate_gain",
    "I": "integral",
}
"""Symbols in the laws; b, K, D and I are keys of an axis."""

LOOP = "docs/control.md of rotorfit: a loop in Python that reads this file, and what each law does"

UNITS: Mapping[str, str] = {
    "command_frame": "frame in which the vehicle takes x and y; the law gives them in `frame`",
    "rate": "commands a second, each computed from a fresh pose",
    "latency": "s, from the exposure of a pose to the command that uses it",
    "bandwidth": "rad/s",
    "input": "m/s^2 (yaw: rad/s^2) per unit of the command",
    "damping": "1/s",
    "delay": "s, from the command until the motion answers",
    "full_scale": "largest command, in its own unit; left out where the card gives commands in SI and no limit",
    "stiffness": "1/s^2",
    "rate_gain": "1/s",
    "integral": "1/s^3",
    "filter_time": "s, of the filtered difference of the error",
    "observer": "1, 1/s, 1/s^2: corrections of p, v, d per error of the predicted pose, once a command",
    "phase_margin": "deg",
    "delay_margin": "s",
    "retuned_at": "s of the flight that `rotorfit track --tune` followed",
    "regime": "how often the vehicle had changed by then in that flight",
}


def tuning_mapping(tuning: Tuning, model: Model) -> dict[str, Any]:
    """Gains, margins and provenance as plain JSON types; None stands for infinite and missing numbers."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "rotorfit": __version__,
        "design": tuning.kind,
        "law": LAWS[tuning.kind],
        "symbols": dict(SYMBOLS),
        "loop": LOOP,
        "frame": "heading: x forward, y left, z up, yaw counter-clockwise",
        "command_frame": model.card.command_frame,
        "sending": WORLD_COMMANDS if model.card.command_frame == "world" else None,
        "rate": tuning.rate,
        "latency": tuning.latency,
        "note": tuning.note or None,
        "units": dict(UNITS),
        "axes": {axis: _axis(one, command_of(model.card, axis).text) for axis, one in tuning.axes.items()},
        "refused": dict(tuning.refused),
        "model": {
            "card": model.card.name,
            "method": model.method,
            "structure": model.structure,
            "flights": [{"path": one.path, "sha256": one.sha256, "span": list(one.span)} for one in model.flights],
        },
    }


def _axis(one: AxisTuning, command: str) -> dict[str, Any]:
    law, around, believed = one.law, one.margins, one.robustness
    return {
        "command": command,
        "full_scale": one.full_scale,
        "bandwidth": one.bandwidth,
        "input": law.input,
        "damping": law.damping,
        "delay": law.delay,
        "stiffness": law.stiffness,
        "rate_gain": law.rate,
        "integral": None if law.observer else law.integral,  # an observer replaces these two
        "filter_time": None if law.observer else law.filter_time,
        "observer": None if law.observer is None else list(law.observer),
        "nominal": {
            "gain_margin_below": around.gain[0],
            "gain_margin": _finite(around.gain[1]),
            "phase_margin": math.degrees(around.phase),
            "delay_margin": _finite(around.delay),
            "peak_sensitivity": around.peak,
        },
        "under_covariance": {
            "draws": believed.draws,
            "seed": believed.seed,
            "unstable_share": believed.unstable,
            "gain_margin_below": believed.gain[0],
            "gain_margin": _finite(believed.gain[1]),
            "phase_margin": math.degrees(believed.phase),
            "delay_margin": _finite(believed.delay),
            "peak_sensitivity": _finite(believed.peak),
        },
        "command_noise": one.noise,
        "note": one.note,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def save_gains(tuning: Tuning, model: Model, path: str | Path) -> Path | None:
    """Writes a gains file: TOML, or YAML, by the suffix of the name.

    Returns:
        Path at which a replaced file is kept; None if there was none.

    Raises:
        ModelError: The name has another suffix.
        LogError: Its folder is missing.
    """
    check_folder(Path(path))
    return write_gains(tuning_mapping(tuning, model), path)


def check_gains_name(path: Path) -> None:
    """Refuses a name with another suffix.

    Raises:
        ModelError: The name has another suffix.
    """
    if path.suffix not in SUFFIXES:
        raise ModelError(f"{path}: gains are written as {', '.join(SUFFIXES)}; give such a name")


def write_gains(mapping: Mapping[str, Any], path: str | Path, keep: bool = True) -> Path | None:
    """Writes a mapping of `tuning_mapping`, as `save_gains` does; `keep` as in `write_whole`.

    Raises:
        ModelError: The name has another suffix.
    """
    path = Path(path)
    check_gains_name(path)
    mapping = _without_none(mapping)
    if path.suffix == ".toml":
        import tomli_w

        return write_whole(path, tomli_w.dumps(mapping), keep)
    from ruamel.yaml import YAML

    text = StringIO()
    YAML().dump(mapping, text)
    return write_whole(path, text.getvalue(), keep)


def read_gains(path: str | Path) -> dict[str, Any]:
    """The contents of a gains file, as `tuning_mapping` gives them, without the keys that have no number.

    Raises:
        ModelError: It is not there, is not a gains file, or is damaged.
    """
    path = Path(path)
    check_gains_name(path)
    try:
        mapping = _parsed(path)
        if (version := mapping.get("version", VERSION)) != VERSION:
            raise ModelError(
                f"{path}: gains version {shown(version)}, this one reads {VERSION}; use the rotorfit that wrote it"
            )
        check_finite(mapping)
        for axis, one in mapping["axes"].items():
            law_of(mapping, axis)
            float(one["bandwidth"])
    except OSError as error:
        raise ModelError(f"{path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError) as error:
        told = f"{path}: is no gains file of `rotorfit tune` ({type(error).__name__})"
        raise ModelError(mistaken(path, "gains") or told) from None
    return mapping


def _parsed(path: Path) -> dict[str, Any]:
    """The mapping in a TOML or YAML file.

    Raises:
        ValueError: The file has something else.
    """
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".toml":
        return plain_toml(text)
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return dict(YAML(typ="safe").load(text))
    except (YAMLError, RecursionError):
        raise ValueError(path) from None


def law_of(mapping: Mapping[str, Any], axis: str) -> AxisLaw:
    """The law of an axis from a gains file.

    Raises:
        KeyError, TypeError, ValueError: A number that a law needs is missing, or is not a number.
        ZeroDivisionError: The rate is 0.
    """
    one = mapping["axes"][axis]
    kind, observer = mapping["design"], one.get("observer")
    if kind not in LAWS:
        raise ValueError(kind)
    corrections = None
    if observer is not None:
        p, v, d = map(float, observer)
        corrections = (p, v, d)
    return AxisLaw(
        kind,
        period=1.0 / float(mapping["rate"]),
        input=float(one["input"]),
        damping=float(one["damping"]),
        delay=float(one["delay"]),
        latency=float(mapping["latency"]),
        stiffness=float(one["stiffness"]),
        rate=float(one["rate_gain"]),
        integral=float(one.get("integral") or 0.0),
        filter_time=float(one.get("filter_time") or 0.0),
        observer=corrections,
    )


def _without_none(value: Any) -> Any:
    """A mapping without the keys whose value is None, since TOML has no null."""
    if isinstance(value, dict):
        return {key: _without_none(part) for key, part in value.items() if part is not None}
    return value
