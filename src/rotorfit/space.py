"""Space: from what a user says of a room to the fence of a plan."""

from rotorfit.errors import PlanError
from rotorfit.plan import Space

ROOM = "6x4x3"
"""Where nothing is said: the size of a small motion-capture laboratory [m]."""

MARGIN, FLOOR = 0.3, 0.5
"""Distance of the fence from walls and ceiling, and from the floor [m]: half of a Bebop 2 with its guards is 0.2 m, and
below half a metre it flies on the air that the floor throws back."""

SPEED, CLIMB = 1.5, 1.0
"""Largest speed along x and y together, and along z [m/s]."""


def space_of_room(text: str, speed: float = SPEED, climb: float = CLIMB) -> Space:
    """The fence in a room `6x4x3` whose floor's middle is the origin: start in the middle, heading along x.

    Raises:
        PlanError: Not three sizes, or no space left between the margins.
    """
    try:
        x, y, z = (float(part) for part in text.lower().split("x"))
    except ValueError:
        raise PlanError(f"room {text!r} is not length x width x height in m, such as {ROOM}") from None
    return _space(
        (MARGIN - x / 2, MARGIN - y / 2, FLOOR), (x / 2 - MARGIN, y / 2 - MARGIN, z - MARGIN), speed, climb, text
    )


def space_of_box(text: str, speed: float = SPEED, climb: float = CLIMB) -> Space:
    """The fence itself, `x0,y0,z0,x1,y1,z1` in the frame of the poses: start in its middle, heading along x.

    Raises:
        PlanError: Not six numbers, or an empty box.
    """
    try:
        x0, y0, z0, x1, y1, z1 = (float(part) for part in text.split(","))
    except ValueError:
        raise PlanError(f"box {text!r} is not x0,y0,z0,x1,y1,z1 in m, such as -2.7,-1.7,0.5,2.7,1.7,2.7") from None
    return _space((x0, y0, z0), (x1, y1, z1), speed, climb, text)


def _space(
    lower: tuple[float, float, float], upper: tuple[float, float, float], speed: float, climb: float, text: str
) -> Space:
    finite = all(abs(end) < 1e6 for end in (*lower, *upper))
    if not (finite and all(high - low >= 0.2 for low, high in zip(lower, upper, strict=True))):
        raise PlanError(
            f"{text!r} leaves no space to fly in: {MARGIN:g} m are kept from walls and ceiling of a room, {FLOOR:g} m "
            "from its floor, and 0.2 m must be left each way"
        )
    if not (0 < speed < 100 and 0 < climb < 100):
        raise PlanError(f"speed limits of {speed:g} and {climb:g} m/s cannot be flown; give positive ones")
    x, y, z = ((low + high) / 2 for low, high in zip(lower, upper, strict=True))
    return Space(lower, upper, (x, y, z, 0.0), speed, climb)
