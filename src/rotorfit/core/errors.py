"""What can go wrong, as a short tree of exceptions.

    RotorfitError          the user can act: the command line prints one line and ends with 1
    |-- LogError           a file that is missing, empty, damaged or of no known format
    |-- CardError          a card that is wrong, or that names what the log does not hold
    |-- FlightError        a log that holds no usable flight: no pose, no commands, time that runs backwards
    |-- ModelError         a model file that is missing, damaged, or too new; a model asked for what it does not hold
    |-- ExportError        a model that a format cannot hold, an unknown format
    |-- VehicleError    a vehicle of the flight room that is wrong, or that nobody knows
    |-- PlanError          a plan that cannot be made, read, or flown within its limits
    `-- LinkError          a vehicle that cannot be reached, or that must not be flown as it stands

What the data cannot tell is not an error but a status and a `Finding`. A bug is a plain exception with its trace.
"""

from collections.abc import Iterable
from difflib import get_close_matches


class RotorfitError(Exception):
    """One line for the user: what, where, what to try."""


class LogError(RotorfitError):
    """The log cannot be read: missing file, unknown format, no table, damage before the first message."""


class CardError(RotorfitError):
    """The card is wrong or does not fit the log: unknown key, column that is not there, unit that nobody knows."""


class FlightError(RotorfitError):
    """The log holds no usable flight: all poses equal, no commands, no common window, degrees taken for radians."""


class ModelError(RotorfitError):
    """The model file cannot be used: missing, damaged, of a newer version, or without the axis that was asked for."""


class ExportError(RotorfitError):
    """The model cannot be exported so: unknown format, no known axis, a structure that the format cannot hold."""


class VehicleError(RotorfitError):
    """The vehicle of the flight room cannot be used: unknown name, unknown key, a value that no vehicle can have."""


class PlanError(RotorfitError):
    """The plan cannot be made or used: a damaged file, an envelope that it leaves, an axis without a command."""


class LinkError(RotorfitError):
    """The vehicle cannot be reached or must not be flown: no link, no pose, outside the box, an empty battery."""


class LinkOverError(LinkError):
    """What was played back is over: nothing more will come, and nothing is wrong."""


def nearest(name: str, known: Iterable[str]) -> str:
    """`; nearest: 'this'`, the end of an error's text; nothing where nothing is known."""
    by_lower = {option.lower(): option for option in known}
    match = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.0)
    return f"; nearest: {by_lower[match[0]]!r}" if match else ""
