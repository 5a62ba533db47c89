"""rotorfit: from a flight log to a trustworthy model of a velocity-commanded multirotor.

    read -> Log, load_card -> Card, flight_from_log -> Flight, fit -> Fit (holds a Model), validate -> Validation

The names of `__all__` are the public interface. Each is loaded when it is first asked for, because numba, which the
estimator needs, takes longer to import than `rotorfit --help` may.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from rotorfit.card_file import load_card
    from rotorfit.errors import RotorfitError
    from rotorfit.exports import export
    from rotorfit.fit import fit
    from rotorfit.flight import flight_from_log
    from rotorfit.model import simulate
    from rotorfit.model_file import load, save
    from rotorfit.sources import read
    from rotorfit.studio import studio
    from rotorfit.tune import tune
    from rotorfit.validation import validate

__all__ = [
    "RotorfitError",
    "__version__",
    "export",
    "fit",
    "flight_from_log",
    "load",
    "load_card",
    "read",
    "save",
    "simulate",
    "studio",
    "tune",
    "validate",
]

_HOMES = {
    "RotorfitError": "rotorfit.errors",
    "export": "rotorfit.exports",
    "fit": "rotorfit.fit",
    "flight_from_log": "rotorfit.flight",
    "load": "rotorfit.model_file",
    "load_card": "rotorfit.card_file",
    "read": "rotorfit.sources",
    "save": "rotorfit.model_file",
    "simulate": "rotorfit.model",
    "studio": "rotorfit.studio",
    "tune": "rotorfit.tune",
    "validate": "rotorfit.validation",
}
"""Public name to the module that defines it."""


class _Package(ModuleType):
    """Keeps the function `fit` in reach: importing the module of that name would put the module in its place."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
