"""The exceptions, as a short tree.

    RotorfitError          the user can act: the command line prints one line and exits with status 1
    |-- LogError           a file that is missing, empty, damaged or of an unknown format
    |-- CardError          a card that is wrong, or that names what the log does not hold
    |-- FlightError        a log that holds no usable flight: no pose, no commands, time that runs backwards
    |-- ModelError         a model file that is missing, damaged or too new; a model without the requested axis
    |-- ExportError        a model that a format cannot hold, an unknown format
    |-- VehicleError       a vehicle of the flight room that is wrong or unknown
    |-- PlanError          a plan that cannot be made, read, or flown within its limits
    `-- LinkError          a vehicle that cannot be reached, or that must not be flown in its present state

What the data do not identify is not an error but a status and a `Finding`. A bug is a plain exception with a traceback.
"""

from collections.abc import Iterable
from difflib import get_close_matches


class RotorfitError(Exception):
    """One line for the user: what, where, what to try."""


class LogError(RotorfitError):
    """The log cannot be read: missing file, unknown format, no table, damage before the first message."""


class CardError(RotorfitError):
    """The card is wrong or does not fit the log: unknown key, missing column, unknown unit."""


class FlightError(RotorfitError):
    """The log holds no usable flight: all poses equal, no commands, no common window, degrees taken for radians."""


class ModelError(RotorfitError):
    """The model file cannot be used: missing, damaged, of a newer version, or without the requested axis."""


class ExportError(RotorfitError):
    """The model cannot be exported: unknown format, no known axis, a structure that the format cannot hold."""


class VehicleError(RotorfitError):
    """The vehicle of the flight room cannot be used: unknown name, unknown key, a value that no vehicle can have."""


class PlanError(RotorfitError):
    """The plan cannot be made or used: a damaged file, a path outside the envelope, an axis without a command."""


class LinkError(RotorfitError):
    """The vehicle cannot be reached or must not be flown: no link, no pose, outside the box, an empty battery."""


class LinkOverError(LinkError):
    """A replayed flight has ended: no more data will come, and nothing is wrong."""


NEAR = 0.52
"""Least similarity at which one name is offered for another; below, they have little more than a letter in common."""


def nearest(name: str, known: Iterable[str]) -> str:
    """`; nearest: 'this'`, to end an error message; empty where no known name is like it."""
    by_lower = {option.lower(): option for option in known}
    match = get_close_matches(name.lower(), by_lower, n=1, cutoff=NEAR)
    return f"; nearest: {by_lower[match[0]]!r}" if match else ""
