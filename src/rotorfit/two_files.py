"""What there is to say of the clocks of a flight whose commands and poses are from two files."""

from collections.abc import Iterator

from rotorfit.finding import Finding
from rotorfit.one_clock import ANSWER_HALF, Clocks


def two_files(clocks: Clocks) -> Iterator[Finding]:
    """Findings about the clocks of commands and poses that are from different files."""
    if clocks.refused:
        yield Finding(
            "clock_source_refused",
            "warning",
            f"the vehicle's own motion cannot tell how its clock stands to that of the poses: {clocks.refused}",
            "it is not used",
            "check that both files are of one flight and of one vehicle, and [velocity] and [attitude] of the card",
        )
    if clocks.later:
        late = ", ".join(f"{sensor} by {1e3 * lag:.0f} ms" for sensor, lag in clocks.later.items())
        yield Finding(
            "clock_sensors_disagree",
            "warning",
            f"the vehicle's own sensors do not agree on its clock: late against {', '.join(clocks.explained)}: {late}",
            "the late ones were left out; by as much as the others are late, too, the delay comes out too long",
            "where the latency of a stamp is known, give it as a negative offset of its time in the card",
        )
    if clocks.includes_delay:
        yield _includes_delay(clocks)
    elif clocks.moved:
        yield Finding(
            "clocks_joined",
            "info",
            f"the clock of the poses stands to that of the commands at {_figures(clocks)}, by {_explained(clocks)}",
            f"the commands were moved, and {1e3 * clocks.half_width:.1f} ms went into the delay's interval; by as much "
            "as the vehicle's own motion is stamped late, the delay comes out too long",
            "where the latency of that stamp is known, give it as a negative offset of its time in the card",
        )
    elif clocks.differs:
        yield Finding(
            "clock_offset",
            "warning",
            f"the clocks of the two files are taken as one, since {clocks.stated}, but by {_explained(clocks)} that of "
            f"the poses stands to that of the commands at {_figures(clocks)}",
            "unless the vehicle's own motion is stamped that late, the delay of every axis comes out "
            f"{1e3 * abs(clocks.offset):.0f} ms too {'long' if clocks.offset > 0 else 'short'}",
            'if they are two clocks, leave clock = "one" out of the card',
        )
    elif clocks.source == "none":
        yield Finding(
            "clock_unchecked",
            "info",
            f"commands and poses are from two files whose clocks are taken as one, since {clocks.stated}",
            "whatever the clocks differ by is in the delay of every axis",
            "record the vehicle's own velocity or heading beside the commands: it checks the clocks",
        )


def _includes_delay(clocks: Clocks) -> Finding:
    return Finding(
        "clock_includes_delay",
        "warning",
        "commands and poses are from two files, and only the answer to the commands tells how their clocks stand: the "
        f"answer is stamped {clocks.with_delay:+.2f} +- {ANSWER_HALF:.2f} s (95 %) after its command, offset and delay "
        f"together, by {_explained(clocks)}",
        "what part of that is the delay cannot be told, and no delay is published; input gain and damping keep their "
        "values, but for a drift of the clocks",
        "record the vehicle's own velocity or heading beside the commands and name it in the card, or write "
        'clock = "one" there if the clocks are one',
    )


def _figures(clocks: Clocks) -> str:
    return (
        f"{clocks.offset:+.4f} s (95 %: +-{1e3 * clocks.half_width:.1f} ms), drift {1e6 * clocks.drift:+.0f} us/s "
        f"(+-{1e6 * clocks.drift_half_width:.0f})"
    )


def _explained(clocks: Clocks) -> str:
    """What told the offset, with the share of it that the poses explain."""
    return ", ".join(f"{name} ({100 * share:.0f} % explained)" for name, share in clocks.explained.items())
