"""What the tests of flying share: a plan, a room, links that fail; as a program, a flight by the wall clock."""

import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import tomli_w

from rotorfit.core.errors import LinkError
from rotorfit.core.flight_plan import AxisExcitation, Feedback, Flown, Plan, Space
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.flight_loop import fly
from rotorfit.flying.links.link import Action, Link
from rotorfit.flying.links.sim import SimLink
from rotorfit.flying.operator import operator_abort
from rotorfit.flying.recorder import Recorder, card_as_recorded, record
from rotorfit.planning.belief import belief_from_card, belief_mapping
from rotorfit.planning.signals import paper_sines
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.vehicle import load_vehicle

BEBOP = load_vehicle("bebop2")
CARD = card_from_mapping(BEBOP.card(), BEBOP.name)
SPACE = Space((-3.0, -3.0, 0.3), (3.0, 3.0, 3.0), (0.0, 0.0, 1.5, 0.0), 2.5, 1.5)
SECOND = 1_000_000_000
HOVER = [0.0, 0.0, 0.0, 0.0]


def plan_of(duration: float = 12.0, feedback: bool = True, amplitude: float = 0.5, rate: float = 50.0) -> Plan:
    """The paper's two sines on x and y, by feedback in their place, for a Bebop 2 in the room."""
    signals = tuple(AxisExcitation(a, "command", 0.0, duration, paper_sines(a, amplitude)) for a in ("x", "y"))
    belief = {key: value for key, value in belief_mapping(belief_from_card(CARD)).items() if key != "covariance"}
    steering = Feedback(("x", "y", "z", "yaw")) if feedback else None
    return Plan("test", "two_sines", BEBOP.card(), rate, duration, 1.0, signals, steering, SPACE, belief)


def room_link(conditions: Conditions | None = None, seed: int = 1, **start: object) -> SimLink:
    return SimLink(FlightRoom(BEBOP, conditions or Conditions(), seed, **start))  # type: ignore[arg-type]


class Watched:
    """A link that remembers what is sent; and fails as it is told to."""

    def __init__(self, link: Link) -> None:
        self.link, self.live, self.fail_safe, self.silence, self.undone = (
            link, link.live, link.fail_safe, link.silence, link.undone,
        )  # fmt: skip
        self.began = link.now
        self.sent: list[tuple[float, list[float]]] = []
        self.acts: list[str] = []
        self.samples: Callable[[float, list[Sample]], list[Sample]] = lambda _, samples: samples
        self.dead_from = float("inf")
        self.oversleep: dict[float, float] = {}

    @property
    def now(self) -> int:
        return self.link.now

    @property
    def since(self) -> float:
        return (self.link.now - self.began) / SECOND

    def send(self, command: Sequence[float]) -> Sequence[float]:
        self.sent.append((self.since, list(command)))
        if self.since >= self.dead_from:
            raise LinkError("the radio is gone")
        return self.link.send(command)

    def receive(self, until: int) -> list[Sample]:
        if self.since >= self.dead_from:
            raise LinkError("the radio is gone")
        for due in [due for due in self.oversleep if self.since >= due]:
            until += round(self.oversleep.pop(due) * SECOND)
        return self.samples(self.since, self.link.receive(until))

    def act(self, action: Action) -> None:
        self.acts.append(action)
        if self.since >= self.dead_from:
            raise LinkError("the radio is gone")
        self.link.act(action)


class Slow(Watched):
    """The same, taking a command only so often [s], as a radio that is full."""

    def __init__(self, link: Link, interval: float) -> None:
        super().__init__(link)
        self.interval, self.last = round(interval * SECOND), link.now

    def receive(self, until: int) -> list[Sample]:
        self.last = max(until, self.last + self.interval)
        return super().receive(self.last)


class WallPaced(Watched):
    """The same at the pace of the wall clock."""

    def __init__(self, link: Link) -> None:
        super().__init__(link)
        self.live, self.zero = True, time.monotonic_ns() - link.now

    @property
    def now(self) -> int:
        return time.monotonic_ns() - self.zero

    def receive(self, until: int) -> list[Sample]:
        time.sleep(max(0, until - self.now) / SECOND)
        return self.link.receive(until)


def recording(path: Path, plan: Plan) -> Recorder:
    card = tomli_w.dumps(card_as_recorded(plan.card))
    return record(path, {"plan": f'name = "{plan.name}"\n', "card": card, "link": "test"})


def flown(link: Link, path: Path, plan: Plan | None = None, **options: object) -> Flown:
    plan = plan or plan_of()
    return fly(plan, link, recording(path, plan), **options)  # type: ignore[arg-type]


def main() -> None:
    """Flies 30 s by the wall clock to a file that is named, and prints how it ended."""
    with operator_abort() as abort:
        link = WallPaced(room_link())
        link.receive(link.now + SECOND // 10)  # compiled before the clock matters
        link.zero = time.monotonic_ns() - link.link.now
        print("begun", flush=True)
        plan = replace(plan_of(30.0), rate=20.0)  # few enough that a busy machine does not starve the flight
        result = flown(link, Path(sys.argv[1]), plan, land=False, abort=abort)
    print(json.dumps({**asdict(result), "path": str(result.path), "sent": link.sent}), flush=True)


if __name__ == "__main__":
    main()
