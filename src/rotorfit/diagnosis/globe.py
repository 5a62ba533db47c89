"""Latitude and longitude: what degrees of them are in metres, on the plane that touches the ellipsoid there."""

import math
import re

from rotorfit.flights.columns import name_without_unit

EQUATOR, SQUASHED = 6378137.0, 6.69437999014e-3
"""Semi-major axis [m] and squared eccentricity of WGS 84.

Source: NIMA TR8350.2, tables 3.1 and 3.3.
"""

_LATITUDE, _LONGITUDE = r"(?:^|_)(?:lat|latitude)$", r"(?:^|_)(?:lon|lng|long|longitude)$"


def is_latitude(source: str | float) -> bool:
    """Whether a column is named as a latitude."""
    return _is_named(source, _LATITUDE)


def is_longitude(source: str | float) -> bool:
    """Whether a column is named as a longitude."""
    return _is_named(source, _LONGITUDE)


def _is_named(source: str | float, pattern: str) -> bool:
    return re.search(pattern, name_without_unit(str(source).rpartition(":")[2])) is not None


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Metres to the east for a degree of longitude, and to the north for one of latitude.

    Args:
        latitude: Of the place [deg].

    Source: J. P. Snyder, Map Projections: A Working Manual (1987), equations 4-18 to 4-21.
    """
    phi = math.radians(latitude)
    bent = 1 - SQUASHED * math.sin(phi) ** 2
    east = EQUATOR / math.sqrt(bent) * math.cos(phi)
    north = EQUATOR * (1 - SQUASHED) / bent**1.5
    return math.radians(east), math.radians(north)


def scale_and_offset(scale: float, place: float) -> tuple[float, float]:
    """Scale and offset, in digits for a card, that turn a longitude or a latitude into metres from that of a place.

    Args:
        scale: Metres in one of its units.
        place: In that unit.
    """
    short = float(f"{scale:.6g}")
    return short, round(-short * place, 2)
