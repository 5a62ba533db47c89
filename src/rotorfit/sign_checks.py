"""Commands that lead the other way all at once: a pose with z down that is read as one with z up, or the reverse.

Half a turn about the vehicle's forward axis turns y, z and yaw and leaves x. So the motion alone does not tell a pose
in NED from commands that are forward, right, down and clockwise; the height does, where the floor is at 0.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from rotorfit.answers import Answer, answers_of
from rotorfit.card import Card
from rotorfit.finding import Finding
from rotorfit.flight import Flight
from rotorfit.regression import Motion

OVER = ("y", "z", "yaw")
"""What half a turn about the forward axis turns."""


def height_sign(flight: Flight) -> int:
    """+1 where the vehicle is above 0 throughout, -1 where it is below, 0 where z says nothing."""
    z = flight.position[:, 2]
    return int(np.min(z) > 0) - int(np.max(z) < 0)


def overturned(told: Mapping[str, Answer], height: int) -> tuple[str, ...]:
    """Which of y, z and yaw lead the other way, where half a turn about the forward axis explains that; else none.

    One axis alone is not enough, unless the vehicle flies below the floor.

    Args:
        told: Command to answer, as the card has them.
        height: As of `height_sign`.
    """
    sure = {name: answer.sign < 0 for name, answer in told.items() if answer.axis == name}
    turned = tuple(name for name in OVER if sure.get(name))
    kept = sure.get("x", False) or any(name in sure and not sure[name] for name in OVER)
    return () if kept or len(turned) < (1 if height < 0 else 2) else turned


def sign_findings(card: Card, flight: Flight, motion: Motion) -> Iterator[Finding]:
    """Findings about signs that are turned together.

    Args:
        card: That was applied.
        flight: What came of it.
        motion: Of the flight.
    """
    told, height = answers_of(flight, motion).of, height_sign(flight)
    turned = overturned(told, height)
    if not turned or card.command_frame != "heading":
        return
    names = " and ".join(filter(None, (", ".join(turned[:-1]), turned[-1])))
    sure = ", ".join(f"{told[name].certainty:.0f}" for name in turned)
    straight = ", that of x as it should" if "x" in told and told["x"].axis == "x" else ""
    where = {1: "; z of the pose is above 0 throughout", -1: "; z of the pose is below 0 throughout", 0: ""}[height]
    other = "ENU" if card.frame == "NED" else "NED"
    ways = [
        f'is the pose {other}? Write frame = "{other}" at the top of the card (now "{card.frame}")',
        f"are the commands forward, right, down, clockwise? Turn the scale of {names} in [command]",
    ]
    yield Finding(
        "axes_turned",
        "warning",
        f"by the motion the command of {names} leads the other way ({sure} standard errors){straight}{where}",
        f"the input gain of {names} comes out negative; delay and damping keep their values",
        "; or ".join(ways if height <= 0 else ways[::-1]),
    )
