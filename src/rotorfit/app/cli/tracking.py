"""The verb that tracks a vehicle while it flies, or a log as if it were live."""

import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rotorfit.app.cli.options import (
    AFTER,
    LONGEST_LINE,
    PORT,
    TUNE,
    Number,
    card_option,
    compiled_beforehand,
    file_at,
    say_kept,
    silence,
    structure_of,
    to_stderr,
)
from rotorfit.core.plain import line_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rotorfit.app.live.outlets import Recording, Remembering
    from rotorfit.app.live.regained import Message, Regaining
    from rotorfit.app.live.serving import Views
    from rotorfit.app.terminal.printer import Printer
    from rotorfit.core.errors import RotorfitError
    from rotorfit.core.flight_data import Flight
    from rotorfit.core.tracked import Track, Tracked
    from rotorfit.tracking.earlier import Earlier


@click.command()
@click.argument("logs", metavar="[LOG]", nargs=-1)
@click.option(
    "--link",
    metavar="NAME[:ADDRESS]",
    help="Listen to a vehicle that somebody else flies: sim, ros1, ros2, mavlink; or to replay:LOG.",
)
@card_option("the one that fits")
@click.option("--for", "seconds", type=Number(0.1, None, 60), metavar="S", help="Listen for S seconds.")
@click.option(
    "--patience",
    type=Number(0, None, 60),
    default=60.0,
    show_default=True,
    metavar="S",
    help="How long to wait for a silent vehicle [s].",
)
@AFTER
@TUNE
@click.option("--record", type=file_at(), metavar="F.mcap", help="Record the received samples, states and alarms.")
@click.option(
    "--state", "memory", type=file_at(), metavar="FILE", help="Store the tracker's state in a file, and resume from it."
)
@click.option(
    "--page",
    type=PORT,
    is_flag=False,
    flag_value=0,
    metavar="[PORT]",
    help="Live page on 127.0.0.1; default of PORT: any free one.",
)
@click.option(
    "--foxglove",
    type=PORT,
    is_flag=False,
    flag_value=8765,
    metavar="[PORT]",
    help="Foxglove WebSocket on 127.0.0.1, also read by PlotJuggler; default of PORT: 8765.",
)
@click.option(
    "--publish",
    metavar="ROS[:PREFIX]",
    help="Publish the estimates, but no commands, on topics of ros1 or ros2; default of PREFIX: /rotorfit.",
)
@click.option("--jsonl", is_flag=True, help="Print one JSON object per line: states, alarms, and the end.")
@click.option(
    "--false-alarms-per-hour",
    "false_alarms",
    type=Number(1e-6, 60, 0.1),
    default=0.1,
    metavar="N",
    show_default=True,
    help="Largest expected number of false alarms per hour.",
)
@click.option(
    "--structure",
    metavar="S",
    callback=structure_of,
    help="Law of every axis; default: averaged, over the laws that the data do not distinguish.",
)
@click.option(
    "--pace",
    type=Number(0.01, None, 2),
    metavar="P",
    help="Playback speed: 1 is real time, the default for a link; default for a log: as fast as possible.",
)
@click.option("-o", "output", type=file_at(), metavar="model.json", help="Write the model of each regime.")
@click.option("--report", type=file_at(), metavar="track.html", help="Write a page about the flight.")
def track(
    logs: tuple[str, ...],
    link: str | None,
    card: str | None,
    seconds: float | None,
    patience: float,
    after: Path | None,
    gains: str | None,
    record: Path | None,
    memory: Path | None,
    page: int | None,
    foxglove: int | None,
    publish: str | None,
    jsonl: bool,
    false_alarms: float,
    structure: Any,
    pace: float | None,
    output: Path | None,
    report: Path | None,
) -> None:
    """Estimate the model while the vehicle flies, and report when it changes. Sends no commands."""
    from rotorfit.app.live.serving import Views
    from rotorfit.app.terminal.printer import Printer
    from rotorfit.app.workflows import MODEL_MARK, check_destination, check_page
    from rotorfit.core.laws import AVERAGED
    from rotorfit.core.writing import check_place
    from rotorfit.flying.mission import check_new
    from rotorfit.tracking.earlier import earlier_of

    if len(logs) > 1:
        raise click.UsageError(f"one LOG, not {len(logs)}; a card is named by --card, an earlier model by --after")
    log = logs[0] if logs else None
    if (log is None) == (link is None):
        raise click.UsageError("name a LOG, or a --link to listen to: one of the two")
    if link is None and (record or memory or seconds):
        raise click.UsageError(
            "--record, --state and --for are for a --link; a LOG is a recording already, and LOG@0:60 is a part of it"
        )
    if output:
        check_destination(output, MODEL_MARK)
    if report:
        check_page(report)
    if memory:
        check_place(memory)
    if record:
        record = _next_part(record) if memory and memory.exists() else record
        check_new(record)
    earlier = earlier_of(after) if after else None
    out, err = (
        Printer(link is not None, [to_stderr, silence]),
        Printer(link is not None, [lambda: silence(stderr=True)]),
    )
    regaining = _regaining(gains, jsonl, earlier, out, err) if gains is not None else None
    asked = _Asked(card, structure, false_alarms, pace, jsonl, earlier, regaining, out, err)
    stopped, trouble = "", None
    with Views(page, foxglove, publish, str(link or log), lambda text: click.echo(text, err=True)) as views:
        if link is not None:
            result, flight, stopped, trouble = _listened(link, asked, views, seconds, patience, record, memory)
        else:
            result, flight, stopped = _replayed(str(log), asked, views)
        options = {"--card": card, "--structure": None if structure == AVERAGED else structure, "--after": after}
        again = [str(log or record), *(word for pair in options.items() if pair[1] for word in map(str, pair))]
        written = _told(result, flight, asked, output, report, again)
    if trouble:
        _say_error(str(trouble), err)
    # a log that was stopped was not read to its end
    _left(out, err, bool(stopped), 1 if trouble or not written or (stopped and log) else 0)


def _left(out: "Printer", err: "Printer", at_once: bool, code: int) -> None:
    """Leaves with an exit code when all is read, or where the operator has ended it, when the reader stalls."""
    read = out.close(patient=not at_once)
    if out.spared or not read:
        missing = f"{out.spared} states" if read else "the last lines"
        err.take(lambda: click.echo(f"{missing} were not printed: nobody read the output", err=True))
    if not (err.close(patient=False) and read):
        os._exit(code)
    if code:
        raise SystemExit(code)


def _next_part(record: Path) -> Path:
    """The recording of a tracker that resumes: its first name that is free, NAME, NAME-2, NAME-3 and so on."""
    parts = (record if number == 1 else record.with_stem(f"{record.stem}-{number}") for number in count(1))
    free = next(part for part in parts if not part.exists())
    if free != record:
        click.echo(f"{record} is kept; the recording goes on in {free}", err=True)
    return free


@dataclass(frozen=True)
class _Asked:
    """How a vehicle is tracked, from a link or a log; see the options of the same names.

    Attributes:
        earlier: The model of `--after`.
        regaining: What `--tune` does; None without it.
        out: Prints to stdout.
        err: Prints to stderr.
    """

    card: str | None
    structure: Any
    false_alarms: float
    pace: float | None
    jsonl: bool
    earlier: "Earlier | None"
    regaining: "Regaining | None"
    out: "Printer"
    err: "Printer"


def _told(
    result: "Track",
    flight: "Flight | None",
    asked: _Asked,
    output: Path | None,
    report: Path | None,
    again: Sequence[str],
) -> bool:
    """Writes models and report, and prints the end whether or not they could be written.

    Args:
        result: The track.
        flight: The flight, if it is known.
        asked: How it was tracked.
        output: Where the models go.
        report: Where the page goes.
        again: Log and options that track the same flight.

    Returns:
        Whether all was written; if not, stderr says what was not, and why.
    """
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.tracking import track_view

    files = _written(result, output, asked.err) if output else [None] * len(result.regimes)
    page = None
    if report and flight:
        from rotorfit.reporting import write_timeline

        made = _tried(partial(write_timeline, result, flight, report, files, again), report, asked.err)
        page = report if made else None
    known = sum(regime.model is not None for regime in result.regimes) if output else 0
    complete = sum(file is not None for file in files) == known and page == (report if flight else None)
    if asked.jsonl:
        line = json.dumps(_end(result, files, page), allow_nan=False)
        asked.out.take(lambda: click.echo(line))
        return complete
    asked.out.take(lambda: show(track_view(result)))
    written = [f"Model written to {file}." for file in files if file]
    if output and not known:
        written.append("No model written: nothing was identified.")
    if asked.regaining:
        written.append(asked.regaining.summary)
    if page:
        written.append(f"Report written to {page}.")
    asked.out.take(lambda: click.echo("".join(f"{line}\n" for line in written), nl=False))
    return complete


def _tried(write: "Callable[[], Path | None]", path: Path, err: "Printer") -> bool:
    """Writes a file, and says where the earlier one is kept, or why it could not be written; whether it was."""
    from rotorfit.core.errors import RotorfitError

    try:
        kept = write()
    except RotorfitError as error:
        _say_error(str(error), err)
    except OSError as error:
        _say_error(f"{path}: {error.strerror or error}; check its folder and the room on the disk", err)
    else:
        err.take(lambda: say_kept(kept))
        return True
    return False


def _say_error(text: str, err: "Printer") -> None:
    """Says on stderr what went wrong, as where it ends a command."""
    err.take(lambda: click.echo(f"Error: {line_of(text, LONGEST_LINE)}", err=True))


def _regaining(path: str, jsonl: bool, earlier: "Earlier | None", out: "Printer", err: "Printer") -> "Regaining":
    """Publishes new gains, each as a line of JSON or in words."""
    from rotorfit.app.live.regained import regaining_of
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.cockpit import line_cleared
    from rotorfit.app.terminal.tracking import gains_view

    def show_gains(message: "Message") -> None:
        if jsonl:
            click.echo(json.dumps(message, allow_nan=False))
        else:
            line_cleared()
            show(gains_view(message))

    return regaining_of(
        path,
        lambda message, _now: out.take(lambda: show_gains(message)),
        lambda kept: err.take(lambda: say_kept(kept)),
        earlier,
    )


def _replayed(log: str, asked: _Asked, views: "Views") -> tuple["Track", "Flight", str]:
    """Tracks a log as if live; the track, the flight, and who ended it early, or an empty string."""
    from rotorfit.app.terminal.cockpit import line_cleared
    from rotorfit.app.workflows import load_flight
    from rotorfit.files.log_span import parse_log
    from rotorfit.flying.operator import operator_abort
    from rotorfit.tracking.earlier import check_earlier, limits_of_earlier
    from rotorfit.tracking.replayed import tracked

    flight = load_flight(parse_log(log), asked.card)
    if asked.earlier:
        check_earlier(asked.earlier, flight.card)
    for note in flight.notes:
        click.echo(f"{log}: {note.text}", err=True)
    for finding in flight.findings:
        if finding.severity != "info":
            click.echo(finding.line, err=True)
    for told in limits_of_earlier(asked.earlier, flight.card) if asked.earlier else ():
        click.echo(f"{log}: {told}", err=True)
    compiled_beforehand()
    begun, show_state = time.monotonic(), _shown(asked)
    if asked.regaining:
        asked.regaining.listeners.append(views.gains)
    with operator_abort() as abort:

        def report(state: "Tracked") -> None:
            """Shows a state when its time has come."""
            _wait_for(state.time, begun, asked.pace, abort)
            now = round(state.time * 1e9)
            views.state(state, now, now)
            show_state(state)
            if asked.regaining:
                asked.regaining.state(state, now)

        tuned = asked.regaining is not None
        result = tracked(flight, asked.structure, asked.false_alarms, report, asked.earlier, abort, tuned)
    if stopped := abort():
        line_cleared()
        click.echo(f"{log}: ended by {stopped} at {result.states[-1].time:.1f} s", err=True)
    return result, flight, stopped


def _wait_for(moment: float, begun: float, pace: float | None, abort: "Callable[[], str]") -> None:
    """Sleeps until a moment of the flight [s], played back since `begun` at some pace, or until an abort."""
    while pace and not abort() and (left := moment / pace - (time.monotonic() - begun)) > 0:
        time.sleep(min(left, 0.1))


def _listened(
    link: str,
    asked: _Asked,
    views: "Views",
    seconds: float | None,
    patience: float,
    record: Path | None,
    memory: Path | None,
) -> tuple["Track", "Flight | None", str, "RotorfitError | None"]:
    """Tracks a link; the track, the remembered part of the flight, who ended it, and what was lost, if anything."""
    from rotorfit.app.live.outlets import Recording, Remembering
    from rotorfit.app.live.session import card_for_link, track_link, with_recordings
    from rotorfit.app.terminal.cockpit import line_cleared, shown_line
    from rotorfit.app.terminal.tracking import line_of as state_line_of
    from rotorfit.core.errors import LinkError, LogError
    from rotorfit.flying.links.opening import open_listener
    from rotorfit.flying.links.sim import changes_missed
    from rotorfit.flying.listening import Listening
    from rotorfit.flying.operator import operator_abort
    from rotorfit.tracking.earlier import check_earlier, limits_of_earlier
    from rotorfit.tracking.flight_so_far import UNRECORDED
    from rotorfit.tracking.tracker import Tracker

    chosen = card_for_link(link, asked.card)

    def say(text: str) -> None:
        asked.err.take(line_cleared)
        asked.err.take(lambda: click.echo(f"{link}: {text}", err=True))

    if asked.earlier:
        check_earlier(asked.earlier, chosen)
        for told in limits_of_earlier(asked.earlier, chosen):
            say(told)
    compiled_beforehand()
    with operator_abort() as abort:
        listening = Listening(lambda: open_listener(link, chosen), patience, seconds, asked.pace or 1.0, abort)
        with Tracker(
            chosen,
            asked.structure,
            asked.false_alarms,
            after=asked.earlier,
            live=True,
            paced=not listening.live,
            path=str(record) if record else UNRECORDED,
            tuned=asked.regaining is not None,
        ) as tracker:
            recording = Recording(record, chosen, link) if record else None
            remembering = Remembering(memory, tracker, asked.regaining) if memory else None
            if remembering and remembering.recalled:
                say(f"goes on from {memory}, as the same vehicle; another one, or another payload, needs a new file")
                for alarm in remembering.unrevised:
                    say(f"{alarm.time:.2f} s  {alarm.title}: never revised, so axes and cause are a first guess")
            if link.startswith("sim"):
                from rotorfit.flying.links.sim_pilot import NAME

                say(NAME)
            files = [file for file in (recording, remembering) if file]
            if asked.regaining:
                asked.regaining.listeners += [outlet.gains for outlet in (views, *files)]
            moving = [*views.moving, *([recording.motion] if recording else [])]
            with shown_line(lambda: state_line_of(tracker.state())):
                report = _reporting(asked, files, say)
                result = track_link(tracker, listening, [views, *files], report, say, moving)
            stopped = abort()
            if missed := changes_missed(link, listening.now):
                say(missed)
            result = with_recordings(result, tracker.parts)
    trouble: RotorfitError | None = LinkError(f"{link}: {listening.ended}") if listening.lost else None
    if fault := next((file.fault for file in files if file.fault), ""):
        trouble = LogError(fault)
    return result, tracker.flight(), stopped, trouble


def _reporting(
    asked: _Asked, files: "Sequence[Recording | Remembering]", say: "Callable[[str], None]"
) -> "Callable[[Tracked, int], None]":
    """A function that shows each state of a link, tunes by it, and says once what does not go on as it should."""
    show_state, said = _shown(asked), set[str]()

    def report(state: "Tracked", now: int) -> None:
        """Takes a state and the link's clock [ns]."""
        show_state(state)
        if asked.regaining:
            asked.regaining.state(state, now)
        unread = "nobody reads the output: it waits, and what is recorded goes on" if asked.out.stalled else ""
        if asked.out.fault:
            unread = f"the output takes nothing any more ({asked.out.fault}): alarms and the end come here"
        for fault in {unread, *(file.fault for file in files)} - said - {""}:
            said.add(fault)
            say(fault)
        for key, fault in state.faults.items():
            if key not in said:
                said.add(key)
                say(f"{state.time:.1f} s  {fault}")

    return report


def _shown(asked: _Asked) -> "Callable[[Tracked], None]":
    """A function that prints each state, as JSON or as what is new in it."""
    from rotorfit.app.live.outlets import lines_of
    from rotorfit.app.terminal import show
    from rotorfit.app.terminal.cockpit import line_cleared
    from rotorfit.app.terminal.tracking import news

    before: Tracked | None = None

    def printed(state: "Tracked") -> None:
        """Prints a state, compared with the one that was printed before."""
        nonlocal before
        if asked.jsonl:
            for line in lines_of(state):
                click.echo(line)  # which flushes
        else:
            line_cleared()
            show(news(before, state))
        before = state

    return lambda state: asked.out.take(lambda: printed(state), spare=not state.alarms)


def _end(result: "Track", files: Sequence[Path | None], page: Path | None) -> dict[str, Any]:
    """The last line of JSON."""
    return {
        "type": "end",
        "time": result.states[-1].time,
        "alarms": len(result.alarms),
        "regimes": [
            {"start": one.start, "end": one.end, "data": one.data and list(one.data)} for one in result.regimes
        ],
        "models": [str(path) for path in files if path],
        "report": str(page) if page else None,
    }


def _written(result: "Track", output: Path, err: "Printer") -> list[Path | None]:
    """Writes the model of each regime, numbered if there are several; None for one without a model, or not written."""
    from rotorfit.files.models import save

    several = len(result.regimes) > 1
    files: list[Path | None] = []
    for number, regime in enumerate(result.regimes, 1):
        path = output.with_stem(f"{output.stem}-{number}") if several else output
        made = regime.model is not None and _tried(partial(save, regime.model, path), path, err)
        files.append(path if made else None)
    return files
