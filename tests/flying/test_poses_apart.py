"""Two links as one: commands by the first, poses by the second."""

from collections.abc import Sequence
from typing import Any

import pytest

from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flying.links import poses_apart
from rotorfit.flying.links.link import Action, Silence
from rotorfit.flying.links.poses_apart import Joined, join


class Half:
    """A link that remembers."""

    def __init__(self, *samples: Sample, live: bool = True) -> None:
        self.now, self.live, self.fail_safe, self.silence, self.undone = 5, live, "It hovers.", Silence(1.0), ""
        self.samples = list(samples)
        self.sent: list[Sequence[float]] = []
        self.acted: list[str] = []

    def send(self, command: Sequence[float]) -> Sequence[float]:
        self.sent.append(command)
        return command

    def receive(self, until: int) -> list[Sample]:
        assert until == 7
        return self.samples

    def act(self, action: Action) -> None:
        self.acted.append(action)


def test_commands_go_to_the_first_and_poses_come_from_the_second() -> None:
    first = Half(Sample("battery", 1, 3, (0.5,)), Sample("pose", 1, 1, (9.0,) * 7))
    said = Sample("said", 4, 4, (), "the autopilot's clock stepped by +2.000 s: poses before that are mistimed")
    second = Half(Sample("pose", 2, 2, (1.0,) * 7), Sample("velocity", 2, 2, (1.0,) * 4), said)
    link = Joined(first, second)

    link.send((0.1, 0.0, 0.0, 0.0))
    for action in ("take_off", "land", "close"):
        link.act(action)  # type: ignore[arg-type]

    taken = [(sample.stream, sample.received) for sample in link.receive(7)]
    assert taken == [("pose", 2), ("battery", 3), ("said", 4)]
    assert (first.sent, second.sent) == ([(0.1, 0.0, 0.0, 0.0)], [])
    assert (first.acted, second.acted) == (["take_off", "land", "close"], ["close"])
    assert (link.now, link.live, link.fail_safe) == (5, True, "It hovers.")
    first.silence = Silence(5.0)  # learnt from the vehicle's parameters, after the two were joined
    assert link.silence == Silence(5.0)


def test_the_other_link_is_opened_for_poses_alone_by_its_address(monkeypatch: pytest.MonkeyPatch) -> None:
    addresses: list[str] = []

    def module(name: str) -> Any:
        assert name == "rotorfit.flying.links.ros1"
        return type("", (), {"open_poses": staticmethod(lambda address: addresses.append(address) or Half())})

    monkeypatch.setattr(poses_apart, "import_module", module)

    assert join(Half(), "ros1:/vicon/tello/tello").live
    assert addresses == ["/vicon/tello/tello"]


def test_a_simulated_vehicle_and_an_unknown_source_are_refused() -> None:
    with pytest.raises(LinkError, match="leave --poses out"):
        join(Half(live=False), "ros1:/pose")
    with pytest.raises(LinkError, match="poses come from ros1, ros2, mavlink"):
        join(Half(), "gps")
