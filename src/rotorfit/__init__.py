"""rotorfit: from a flight log to a trustworthy model of a velocity-commanded multirotor.

    read -> Log, load_card -> Card, flight_from_log -> Flight, fit -> Fit (holds a Model), validate -> Validation

The names of `__all__` are the public interface. Each is loaded when it is first asked for, because numba, which the
estimator needs, takes longer to import than `rotorfit --help` may.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rotorfit.version import __version__

if TYPE_CHECKING:
    from rotorfit.app.web import studio
    from rotorfit.assessment.validation import validate
    from rotorfit.control.tuning import tune
    from rotorfit.core.errors import RotorfitError
    from rotorfit.dynamics.trajectory import simulate
    from rotorfit.estimation.fitting import fit
    from rotorfit.exports import export
    from rotorfit.files.cards import load_card
    from rotorfit.files.logs import read
    from rotorfit.files.models import load, save
    from rotorfit.flights.assemble import flight_from_log

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
    "RotorfitError": "rotorfit.core.errors",
    "export": "rotorfit.exports",
    "fit": "rotorfit.estimation.fitting",
    "flight_from_log": "rotorfit.flights.assemble",
    "load": "rotorfit.files.models",
    "load_card": "rotorfit.files.cards",
    "read": "rotorfit.files.logs",
    "save": "rotorfit.files.models",
    "simulate": "rotorfit.dynamics.trajectory",
    "studio": "rotorfit.app.web",
    "tune": "rotorfit.control.tuning",
    "validate": "rotorfit.assessment.validation",
}
"""Public name to the module that defines it."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
