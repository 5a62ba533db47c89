"""Terminal output of a log (tables, cards that fit, the flight), and of the lists of cards and formats."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from rotorfit.app.terminal.tables import View, bullets, finding_view, indented, table, title
from rotorfit.core.card import Card, Channel
from rotorfit.core.finding import told_together
from rotorfit.files.logs.formats import Format
from rotorfit.flights.columns import split_source
from rotorfit.flights.stamps import Rate

if TYPE_CHECKING:
    from rotorfit.diagnosis.survey import CommandActivity, FlightSurvey, Survey, TableSurvey

MANY_TABLES = 12
"""Number of tables above which only the relevant ones are listed."""

OF_THE_FILE = ("damage", "reading")
"""Codes of notes that are shown with the list of tables."""

LEAST_JITTER = 0.01
"""Jitter below which it is not shown [ms]."""


def survey_view(survey: "Survey") -> View:
    """The flight, the cards that fit, and the contents of the log."""
    tables = "1 table" if len(survey.tables) == 1 else f"{len(survey.tables)} tables"
    yield title(f"{survey.path}: {survey.format}, {tables}")
    if survey.damage:
        yield from finding_view(survey.damage)
    if survey.recording:
        yield indented(", ".join(f"{key} {text}" for key, text in survey.recording.items()))
    yield from bullets(survey.notes)
    yield from bullets([f"{since:.2f} s: {text}" for since, text in survey.events])
    yield indented(f"Built-in cards that fit: {', '.join(survey.fitting) or 'none'}")
    if survey.problem:
        yield indented(f"No flight: {survey.problem}", 2, "yellow")
    if survey.flight:
        yield ""
        yield title(f"Flight by the card {survey.card}")
        if survey.why:
            yield indented(f"Proposed: {survey.why}")
        yield from _flight_view(survey.flight)
        for finding in told_together(survey.flight.findings):
            if finding != survey.damage:  # shown first
                yield ""
                yield from finding_view(finding)
    yield ""
    yield from _tables_view(survey)


def _tables_view(survey: "Survey") -> View:
    """Tables with their columns; for a log with many, only those that are relevant to a flight, if any are."""
    shown = [one for one in survey.tables if one.used]
    if len(survey.tables) <= MANY_TABLES or not shown:
        shown = list(survey.tables)
    yield title("Tables")
    for one in shown:
        yield indented(_table_line(one))
        yield indented(", ".join(one.columns), 4, "dim")
    others = len(survey.tables) - len(shown)
    if others:
        yield indented(f"and {others} more that no flight needs, {len(survey.skipped)} not read (--json has them)")
    else:
        yield from bullets([f"{name}: not read: {reason}" for name, reason in survey.skipped.items()])


def _table_line(table: "TableSurvey") -> str:
    if table.rate is None:
        return f"{table.name}: {table.count} samples, no clock recognised"
    return f"{table.name}: {_rate(table.rate)}, by {table.time}"


def _rate(rate: Rate) -> str:
    """Irregularities in the stamps of a stream."""
    if rate.period is None or rate.jitter is None:
        return f"{rate.count} samples"
    troubles = {"repeat a stamp": rate.repeated, "go back in time": rate.reversed, "have no stamp": rate.missing}
    gaps = [f"{rate.gaps} gap{'s' * (rate.gaps > 1)} up to {rate.longest_gap:.3g} s"] if rate.gaps else []
    low, high = (1e3 * side for side in rate.jitter)
    jitter = f"{low:+.2g} to {high:+.2g} ms" if max(-low, high) >= LEAST_JITTER else f"below {LEAST_JITTER:g} ms"
    return ", ".join(
        [
            f"{rate.count} samples in {rate.duration:.2f} s at {1 / rate.period:.4g} Hz",
            f"jitter {jitter}",
            *(gaps or ["no gaps"]),
            *(f"{count} {trouble}" for trouble, count in troubles.items() if count),
        ]
    )


def _flight_view(flight: "FlightSurvey") -> View:
    parts = [f"{start:.2f} to {end:.2f}" for start, end in flight.segments]
    shown = ", ".join([*parts[:6], *(["..."] if len(parts) > 6 else [])])
    clocks = flight.clocks
    yield indented(f"{flight.duration:.2f} s of flight in {len(parts)} segment{'s' * (len(parts) > 1)}: {shown} s")
    yield indented(f"commands: {_rate(flight.command)}")
    yield indented(f"poses: {_rate(flight.pose)}")
    fresh = f"{1 / flight.fresh.period:.4g} Hz" if flight.fresh.period else "no rate"
    yield indented(f"stale poses: {100 * flight.stale_share:.1f} %; the fresh ones come at {fresh}")
    stamped = " as stamped" if any(note.code == "clocks" for note in flight.notes) else ""  # before they were moved
    yield indented(
        f"clocks{stamped}: the poses start {_later(clocks.start_offset)} the commands and end "
        f"{_later(clocks.end_offset)} them; {clocks.overlap:.2f} s in common"
    )
    for name, drift in flight.recorder.items():
        yield indented(
            f"recorder: {name} stamps are logged {1e3 * drift.offset:.3g} ms after the header's "
            f"({1e3 * drift.spread[0]:+.2g} to {1e3 * drift.spread[1]:+.2g} ms), drift {1e6 * drift.drift:.2g} us/s"
        )
    yield _excitation_table(flight.axes)
    yield from bullets([note.text for note in flight.notes if note.code not in OF_THE_FILE])


def _percent(share: float) -> str:
    """A share in whole per cent; a small share is not shown as 0 %, and a large one not as 100 %."""
    if 0 < share < 0.005:
        return "<1 %"
    return ">99 %" if 0.995 <= share < 1 else f"{100 * share:.0f} %"


def _later(offset: float) -> str:
    return f"{abs(offset):.3f} s {'after' if offset >= 0 else 'before'}"


def _excitation_table(axes: "Iterable[CommandActivity]") -> RenderableType:
    out = table("command", "not 0", "RMS", "lowest", "highest", "levels", "at ends", "95 % below")
    for axis in axes:
        out.add_row(
            axis.axis,
            _percent(axis.nonzero_share),
            *(f"{value:.3g}" for value in (axis.rms, axis.low, axis.high)),
            str(axis.levels),
            _percent(axis.extreme_share),
            "-" if axis.bandwidth is None else f"{axis.bandwidth:.2g} Hz",
        )
    return Padding(out, (0, 0, 0, 2), expand=False)


def cards_view(cards: Mapping[str, Card]) -> View:
    """Built-in cards: name, vehicle, columns."""
    for name, card in cards.items():
        yield title(f"{name}: {card.name}")
        yield indented(f"commands: {_columns({'time': card.command_time, **card.command})}")
        yield indented(f"pose: {_columns({'time': card.pose_time, **card.pose})}")


def _columns(channels: Mapping[str, Channel]) -> str:
    """Columns, with their table named once."""
    tables = {split_source(channel.source)[0] for channel in channels.values()}
    if len(tables) > 1:
        return ", ".join(str(channel.source) for channel in channels.values())
    names = ", ".join(split_source(channel.source)[1] for channel in channels.values())
    table = next(iter(tables))
    return f"{table}: {names}" if table else names


def formats_view(formats: Mapping[str, Format]) -> View:
    """The log formats that can be read."""
    out = table("format", "what it is", left=(0, 1))
    for name, form in formats.items():
        out.add_row(name, form.text)
    yield out
    yield Text("A format is found by content, not by name.", style="dim")
