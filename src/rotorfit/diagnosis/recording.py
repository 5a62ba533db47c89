"""Input of the checks of the data: a flight, its log if it has one, and the motion from differentiated poses."""

from dataclasses import dataclass
from functools import cached_property

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight
from rotorfit.core.log import Log
from rotorfit.core.results import Motion
from rotorfit.diagnosis.command_response import Answers, answers_of
from rotorfit.dynamics.kinematics import motion_from_flight


@dataclass(frozen=True)
class Recording:
    """One flight as recorded and as repaired.

    Attributes:
        log: As recorded; None of a flight that is not read from one.
        flight: The flight read from it, commands in the heading frame and after the card's scale.
        motion: Velocity and acceleration of the flight from differentiated poses.
    """

    log: Log | None
    flight: Flight
    motion: Motion

    @property
    def card(self) -> Card:
        """The card that was applied."""
        return self.flight.card

    @cached_property
    def answers(self) -> Answers:
        """Which command moves the vehicle in which direction."""
        return answers_of(self.flight, self.motion)


def recording_of(log: Log | None, flight: Flight) -> Recording:
    """A flight and its log, if it has one, with the motion that several checks need."""
    return Recording(log, flight, motion_from_flight(flight))
