"""rotorfit: from a flight log to a trustworthy model of a velocity-commanded multirotor.

    import rotorfit as rf

    fit = rf.fit("flight1.csv", card="my-drone.toml")
    proof = rf.validate(fit, "flight2.csv")
    rf.report(fit, "flight2.csv", "report.html")

The names of `__all__` are the public interface (docs/api.md). Each is loaded when it is first asked for, because numba,
which the estimator needs, takes longer to import than `rotorfit --help` may.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import rotorfit.core.compiled_code as _compiled_code
from rotorfit.version import __version__

if TYPE_CHECKING:
    from rotorfit.app.applications import convert, export, fly, plan, simulate, state_space, tune
    from rotorfit.app.library import (
        compare,
        diagnose,
        fit,
        flight,
        flight_from_log,
        ladder,
        report,
        save,
        track,
        validate,
    )
    from rotorfit.app.web import studio
    from rotorfit.core.card import Card
    from rotorfit.core.errors import RotorfitError
    from rotorfit.core.finding import Finding
    from rotorfit.core.flight_data import Flight
    from rotorfit.core.flight_plan import Plan
    from rotorfit.core.log import Log, Sample
    from rotorfit.core.model import Axis, Model
    from rotorfit.core.results import Fit, Validation
    from rotorfit.core.tracked import Track
    from rotorfit.files.cards import load_card
    from rotorfit.files.logs import read
    from rotorfit.files.models import load
    from rotorfit.files.plans import load_plan
    from rotorfit.tracking.tracker import Tracker

_compiled_code.keep_compiled_code()

__all__ = [
    "Axis",
    "Card",
    "Finding",
    "Fit",
    "Flight",
    "Log",
    "Model",
    "Plan",
    "RotorfitError",
    "Sample",
    "Track",
    "Tracker",
    "Validation",
    "__version__",
    "compare",
    "convert",
    "diagnose",
    "export",
    "fit",
    "flight",
    "flight_from_log",
    "fly",
    "ladder",
    "load",
    "load_card",
    "load_plan",
    "plan",
    "read",
    "report",
    "save",
    "simulate",
    "state_space",
    "studio",
    "track",
    "tune",
    "validate",
]

_HOMES = {
    "app.applications": ("convert", "export", "fly", "plan", "simulate", "state_space", "tune"),
    "app.library": (
        "compare", "diagnose", "fit", "flight", "flight_from_log", "ladder", "report", "save", "track", "validate",
    ),
    "app.web": ("studio",),
    "core.card": ("Card",),
    "core.errors": ("RotorfitError",),
    "core.finding": ("Finding",),
    "core.flight_data": ("Flight",),
    "core.flight_plan": ("Plan",),
    "core.log": ("Log", "Sample"),
    "core.model": ("Axis", "Model"),
    "core.results": ("Fit", "Validation"),
    "core.tracked": ("Track",),
    "files.cards": ("load_card",),
    "files.logs": ("read",),
    "files.models": ("load",),
    "files.plans": ("load_plan",),
    "tracking.tracker": ("Tracker",),
}  # fmt: skip
"""Module to the public names that it defines; the imports above say the same to type checkers."""


def __getattr__(name: str) -> Any:
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{home}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
