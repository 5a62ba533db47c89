"""Commands that are moved against the poses: what acts when, and what is lost."""

from dataclasses import replace

import numpy as np
import pytest

from flights import by_hand
from rotorfit.core.flight_data import Clocks, Flight, Segment
from rotorfit.flights.clocks.placement import with_later_commands

COMMAND_TIME = np.arange(0.0, 20.0, 0.1)
HELD = ((0.0, 8.0), (12.0, 20.0))


def flight() -> Flight:
    """Commands that count their stamps, without any from 8 to 12 s; poses at 50 Hz."""
    sent = COMMAND_TIME[(COMMAND_TIME < 7.95) | (COMMAND_TIME > 11.95)]
    pose_time = np.arange(0.0, 20.0, 0.02)
    out = by_hand(pose_time, np.zeros((pose_time.size, 4)), sent, np.tile(sent[:, None], 4), HELD)
    return replace(out, clocks=Clocks("command", 1.5, moved=True), reference=np.tile(sent[:, None], 4))


def in_force(flight: Flight, time: float) -> float:
    """The command that acts at a time, by the stamp that it was first given."""
    return float(flight.command[np.searchsorted(flight.command_time, time, side="right") - 1, 0])


@pytest.mark.parametrize("by", [0.13, -0.13, 0.62])
def test_every_command_acts_later_by_as_much(by: float) -> None:
    moved = with_later_commands(flight(), by, "another")
    for segment in moved.segments:
        for time in np.arange(segment.start + 1e-6, segment.end - 0.01, 0.07):
            assert in_force(moved, time) == pytest.approx(in_force(flight(), time - by), abs=1e-9)
    assert np.all(np.diff(moved.command_time) > 0)
    assert np.array_equal(moved.command, moved.reference)
    assert [segment.start in moved.command_time for segment in moved.segments] == [True, True]


def test_what_the_moved_commands_do_not_cover_is_lost_in_whole_steps_between_starts() -> None:
    assert with_later_commands(flight(), 0.13, "another").segments == (Segment(0.5, 8.0), Segment(12.5, 20.0))
    assert with_later_commands(flight(), -0.13, "another").segments == (Segment(0.0, 7.87), Segment(12.0, 19.87))


def test_the_offset_follows_and_a_note_tells_it() -> None:
    moved = with_later_commands(flight(), -0.13, "another")
    assert moved.clocks is not None
    assert moved.clocks.offset == pytest.approx(1.37)
    assert [note.text for note in moved.notes] == [
        "the commands were moved by a further -0.130 s, so that they are answered as another"
    ]


def test_a_segment_that_is_too_short_goes() -> None:
    short = replace(flight(), segments=(Segment(0.0, 0.4), Segment(12.0, 20.0)))
    assert with_later_commands(short, 0.1, "another").segments == (Segment(12.5, 20.0),)
