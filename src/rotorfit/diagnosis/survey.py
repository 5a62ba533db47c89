"""Survey: the contents of a log, the card that fits, and the excitation of the flight."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.display import counted, html_table, number
from rotorfit.core.errors import CardError, FlightError
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES, Array
from rotorfit.core.log import Log, Table
from rotorfit.core.plain import plain_toml
from rotorfit.core.progress import Progress, part_of
from rotorfit.diagnosis.card_choice import joined_by_plus, proposal
from rotorfit.diagnosis.command_checks import spectrum
from rotorfit.diagnosis.doctor import damage_of, findings_of_flight
from rotorfit.diagnosis.recognition import commands_in, pose_in, velocity_in
from rotorfit.files.cards import load_card
from rotorfit.files.log_span import WHOLE, Span, parse_log
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import clock_of, fitting_cards, sample_count, shape_text, split_source, tables_of
from rotorfit.flights.other_tables import sample_rows
from rotorfit.flights.several_files import bound, flights_of
from rotorfit.flights.stamps import (
    MISSING_STAMP,
    ClockDrift,
    ClockRelation,
    Rate,
    Stamps,
    continued,
    in_time,
    rate,
    relation,
    stamps_of,
    stray,
)
from rotorfit.flights.streams import recorder_clock


@dataclass(frozen=True)
class TableSurvey:
    """One table of a log.

    name: As in the log.
    columns: Names, with the shape appended to matrices: `SS (6 x 19780)`.
    count: Number of samples.
    time: Column taken for its clock; None where none was found.
    rate: Rate of that clock.
    used: Whether the card reads it; without a card, whether its names look like commands, a pose or a velocity.
    """

    name: str
    columns: tuple[str, ...]
    count: int
    time: str | None
    rate: Rate | None
    used: bool = True


@dataclass(frozen=True)
class CommandActivity:
    """Activity of one command, weighted by the time for which each value is held, in the unit after the card's scale.

    Attributes:
        axis: One of `AXES`.
        nonzero_share: Share of time in which it is not 0.
        rms: Root mean square.
        low: Smallest value.
        high: Largest value.
        levels: Number of distinct values.
        extreme_share: Share of time at the smallest or largest non-zero value: saturation, if there are many levels.
        bandwidth: Frequency below which 95 % of its power about the mean lies [Hz]; None for a constant.
    """

    axis: str
    nonzero_share: float
    rms: float
    low: float
    high: float
    levels: int
    extreme_share: float
    bandwidth: float | None


@dataclass(frozen=True)
class FlightSurvey:
    """The flight that a card yields from a log.

    Attributes:
        duration: Total length of the segments [s].
        segments: Start and end of each [s].
        command: Rate of the commands as recorded, from the rows that hold one.
        pose: Rate of the poses as recorded, from the rows that hold one.
        fresh: Rate of the fresh poses in the flight.
        stale_share: Share of the recorded poses that repeat the previous one.
        clocks: Relation of the poses' clock to the commands'.
        recorder: `command` and `pose` to the recorder's `log_time` against the `header.stamp`, where both exist.
        axes: Excitation of each commanded axis.
        notes: Repairs.
        findings: Findings of the data doctor before any fit.
    """

    duration: float
    segments: tuple[tuple[float, float], ...]
    command: Rate
    pose: Rate
    fresh: Rate
    stale_share: float
    clocks: ClockRelation
    recorder: Mapping[str, ClockDrift]
    axes: tuple[CommandActivity, ...]
    notes: tuple[Note, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Survey:
    """Contents of a log.

    Attributes:
        path: As given.
        format: Name of the format.
        tables: In the order of the log.
        skipped: Tables that were not decoded, with the reason.
        notes: What was recovered or left out on reading.
        fitting: Names of the built-in cards whose columns are all in the log.
        card: Name stated in the card that was applied; None where none was given and no single one fits.
        flight: The flight that the card yields; None where no card fits or there is no usable flight.
        problem: Why there is no card or no flight, one line.
        why: Why that card was chosen; None where it was given.
        recording: For a log of `rotorfit fly`: `plan` (its name), `link`, `rotorfit` (version).
        events: Events recorded by `rotorfit fly` and `rotorfit track`: seconds since the first message, and the text.
        damage: Finding on the losses of a damaged log.
    """

    path: str
    format: str
    tables: tuple[TableSurvey, ...]
    skipped: Mapping[str, str]
    notes: tuple[str, ...]
    fitting: tuple[str, ...]
    card: str | None
    flight: FlightSurvey | None
    problem: str | None
    why: str | None = None
    recording: Mapping[str, str] = field(default_factory=dict)
    events: tuple[tuple[float, str], ...] = ()
    damage: Finding | None = None

    def __repr__(self) -> str:
        said = self.problem or ""
        if self.flight:
            found = counted(len(self.flight.findings), "finding")
            said = f"read with the card {self.card!r}, {self.flight.duration:.1f} s of flight, {found}"
        return f"Survey({self.path!r}, {self.format}, {counted(len(self.tables), 'table')}: {said})"

    def _repr_html_(self) -> str:
        heads = ("command", "not 0", "rms", "lowest", "highest", "levels")
        rows = [
            (one.axis, f"{one.nonzero_share:.0%}", number(one.rms), number(one.low), number(one.high), str(one.levels))
            for one in (self.flight.axes if self.flight else ())
        ]
        return html_table(repr(self), heads, rows, self.flight.findings if self.flight else ())


def survey(log: Log, card: Card | None = None, span: Span = WHOLE) -> Survey:
    """Surveys a log.

    Args:
        log: As recorded.
        card: The card to apply; None for the log's own, or the built-in card that fits, if there is one.
        span: Part of the flight [s], from the start of its common window.

    Raises:
        CardError: The given card does not fit.
    """
    flight, problem, why = None, None, None
    try:
        if card is None:
            proposed = proposal(log)
            card, why = proposed.card, proposed.why
    except CardError as err:
        problem = str(err)
    if card is not None:
        card = bound(card, log)
        try:
            flight = _flight_survey(log, card, flight_from_log(log, card, span))
        except FlightError as err:
            problem = str(err)
    used = _used(log, card)
    return Survey(
        path=str(log.path),
        format=log.format,
        tables=tuple(_table_survey(log, table, card, used) for table in log.tables.values()),
        skipped=log.skipped,
        notes=log.notes,
        fitting=tuple(fitting_cards(log)),
        card=None if card is None else card.name,
        flight=flight,
        problem=problem,
        why=why,
        recording=_recording(log),
        events=_events(log),
        damage=damage_of(log),
    )


def _events(log: Log) -> tuple[tuple[float, str], ...]:
    """The events of a log: time since the first message, or since the first event where that was earlier [s]; text."""
    stamps = [table.columns["log_time"] for table in log.tables.values() if "log_time" in table.columns]
    times = [event.time for event in log.events] + [int(each[0]) for each in stamps if len(each)]
    begun = min(times, default=0)
    return tuple(((event.time - begun) / 1e9, event.text) for event in log.events)


def _recording(log: Log) -> dict[str, str]:
    """What is attached to a log, the plan by its name; the card is left out, as `Survey.card` names it."""
    told = {key: text for key, text in log.attached.items() if key not in ("plan", "card")}
    if "plan" not in log.attached:
        return told
    try:
        name = plain_toml(log.attached["plan"]).get("name", "without a name")
    except ValueError as error:
        name = f"damaged: {error}"
    return {"plan": str(name), **told}


def survey_logs(paths: Sequence[str], card: str | None = None, progress: Progress | None = None) -> tuple[Survey, ...]:
    """Reads and surveys logs; logs that only together hold what the card names are one flight.

    Args:
        paths: The logs, each as `LOG` or `LOG@T0:T1`.
        card: Name or file of the card to apply; None for the built-in card that fits, if there is one.
        progress: As for `files.logs.read`.

    Raises:
        LogError: A log cannot be read.
        CardError: The given card is invalid, or does not fit.
    """
    chosen = None if card is None else load_card(card)
    asked = [parse_log(path) for path in paths]
    logs = [read(one.path, None, part_of(progress, place, len(asked))) for place, one in enumerate(asked)]
    found = [survey(log, chosen, asked[place].span) for place, log in flights_of(logs, chosen)]
    apart = joined_by_plus(logs) if chosen is None else ""
    return tuple(replace(one, problem=apart) if apart and not one.flight else one for one in found)


def survey_draft(path: str, draft: Path) -> Survey:
    """Reads a log and surveys it with the card that was drafted for it.

    Args:
        path: The log, as `LOG` or `LOG@T0:T1`.
        draft: The card file; it may still be incomplete.

    Raises:
        LogError: The log cannot be read.
    """
    asked = parse_log(path)
    log = read(asked.path)
    try:
        return survey(log, load_card(str(draft)), asked.span)
    except CardError:
        found = survey(log, span=asked.span)
    if found.flight:
        return found
    return replace(found, problem=f"the card drafted in {draft} is not complete: fill in the lines marked EDIT")


def excitation(flight: Flight) -> tuple[CommandActivity, ...]:
    """Excitation of each commanded axis of a flight."""
    starts, ends = (np.array([getattr(part, end) for part in flight.segments]) for end in ("start", "end"))
    time = flight.command_time
    until = np.minimum(np.append(time[1:], np.inf), ends[np.searchsorted(starts, time, side="right") - 1])
    columns = {axis: flight.command[:, AXES.index(axis)] for axis in flight.axes}
    return tuple(_excitation(axis, values, until - time, time) for axis, values in columns.items())


def _excitation(axis: str, values: Array, weight: Array, time: Array) -> CommandActivity:
    low, high = float(np.min(values)), float(np.max(values))
    at_end = ((values == low) | (values == high)) & (values != 0) & (low < high)
    return CommandActivity(
        axis=axis,
        nonzero_share=float(np.sum(weight[values != 0]) / np.sum(weight)),
        rms=float(np.sqrt(np.sum(weight * values**2) / np.sum(weight))),
        low=low,
        high=high,
        levels=len(np.unique(values)),
        extreme_share=float(np.sum(weight[at_end]) / np.sum(weight)),
        bandwidth=_bandwidth(time, values),
    )


def _bandwidth(time: Array, values: Array) -> float | None:
    """Frequency below which 95 % of the power of held values lies [Hz]."""
    if len(time) < 8 or np.ptp(values) == 0:
        return None
    frequency, power = spectrum(time, values)
    total = np.cumsum(power)
    return None if total[-1] == 0 else float(frequency[np.searchsorted(total, 0.95 * total[-1])])


def _flight_survey(log: Log, card: Card, flight: Flight) -> FlightSurvey:
    streams = {"command": (card.command_time, card.command), "pose": (card.pose_time, card.pose)}
    command, pose = (_sound(stamps_of(log, time)[sample_rows(log, time, parts)]) for time, parts in streams.values())
    stale = sum(note.count for note in flight.notes if note.code == "stale_poses")
    recorder = {name: recorder_clock(log, time, parts) for name, (time, parts) in streams.items()}
    return FlightSurvey(
        duration=flight.duration,
        segments=tuple((part.start, part.end) for part in flight.segments),
        command=rate(command),
        pose=rate(pose),
        fresh=rate(np.round(flight.pose_time * 1e9).astype(np.int64)),
        stale_share=stale / len(pose),
        clocks=relation(_ordered(command), _ordered(pose)),
        recorder={name: value for name, value in recorder.items() if value is not None},
        axes=excitation(flight),
        notes=flight.notes,
        findings=findings_of_flight(log, flight),
    )


def _ordered(stamps: Stamps) -> Stamps:
    """The stamps that were recorded, increasing."""
    there = stamps[stamps != MISSING_STAMP]
    return np.asarray(there[in_time(there)])


def _sound(stamps: Stamps) -> Stamps:
    """The stamps as a flight takes them: a clock that starts again goes on, and stray stamps are no samples."""
    stamps = continued(stamps)
    there = np.flatnonzero(stamps != MISSING_STAMP)
    return np.delete(stamps, there[stray(stamps[there])])


def _used(log: Log, card: Card | None) -> frozenset[str]:
    """Names of the tables that are relevant for a flight."""
    if card is not None:
        return tables_of(card) or frozenset(log.tables)
    commands, pose = commands_in(log), pose_in(log)
    told = (commands, pose, velocity_in(log, commands, pose))
    return frozenset(split_source(one.source)[0] for stream in told for one in stream.channels.values())


def _table_survey(log: Log, table: Table, card: Card | None, used: frozenset[str]) -> TableSurvey:
    time = clock_of(log, table, sample_count(table))
    for own in (card.command_time, card.pose_time) if card is not None else ():
        if len(log.tables) == 1 or str(own.source).startswith(f"{table.name}:"):
            time = own
    stamps = stamps_of(log, time) if time is not None else None
    return TableSurvey(
        name=table.name,
        columns=tuple(name + shape_text(values) for name, values in table.columns.items()),
        count=sample_count(table) if stamps is None else len(stamps),
        time=None if time is None else str(time.source).removeprefix(f"{table.name}:"),
        rate=None if stamps is None else rate(stamps),
        used=len(log.tables) == 1 or table.name in used,
    )
