"""What the terminal shows of surveys, models, scores, cards and the demo: text and tables that fit 80 columns."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.text import Text

from rotorfit.accuracy import ERROR_HEADS, PERCENT_HEADS, accuracy_lines, error_rows, percent_rows
from rotorfit.card import Card, Channel, split_source
from rotorfit.clock import Rate
from rotorfit.frames import AXES
from rotorfit.model import COEFFICIENTS, Axis, Interval, Mode, Model
from rotorfit.physics import PhysicsRow, implied_limits, physics_rows
from rotorfit.proof import leave_one_out_view, paired_view, residuals_view
from rotorfit.structure import structure_named
from rotorfit.summary import summary_of_model
from rotorfit.tables import View
from rotorfit.tables import bullets as _list
from rotorfit.tables import finding_view as _finding_view
from rotorfit.tables import indented as _indented
from rotorfit.tables import table as _table
from rotorfit.tables import three_digits as _three_digits
from rotorfit.tables import title as _title

if TYPE_CHECKING:  # they bring numba, which the lists of cards and formats need not wait for
    from rotorfit.demo import Demo
    from rotorfit.leave_one_out import LeaveOneOut
    from rotorfit.pipeline import Comparison
    from rotorfit.survey import Excitation, FlightSurvey, Survey, TableSurvey
    from rotorfit.validation import FlightScores, Validation

_UNITS = {
    "input": ("m/s^2", "rad/s^2"),
    "damping": ("1/s", "1/s"),
    "delay": ("s", "s"),
    "steady_gain": ("m/s", "rad/s"),
    "total_lag": ("s", "s"),
    "delay_plus_lag": ("s", "s"),
    "natural_frequency": ("rad/s", "rad/s"),
    "quadratic_drag": ("1/m", "1/rad"),
    "damping_at_rest": ("1/s", "1/s"),
    "input_up": ("m/s^2", "rad/s^2"),
    "input_down": ("m/s^2", "rad/s^2"),
}
"""Of an axis of translation and of yaw; `input` and `steady_gain` per unit of the command."""

LEAST_JITTER = 0.01
"""Jitter below which its figures say nothing [ms]."""

_UNBROKEN = 2000  # columns: more than any line has
_AT_ONCE = 4  # horizons beside each other in 80 columns

FORMATS = {
    "rosbag1": "ROS 1 bag (.bag)",
    "rosbag2": "ROS 2 bag: its folder, or a lone .db3",
    "mcap": "MCAP with ROS messages (.mcap), encodings cdr and ros1",
    "mat": "MATLAB, version 5 to 7.2 (.mat), also from Octave and scipy",
    "mat73": "MATLAB, version 7.3 (.mat); needs h5py: pip install 'rotorfit[mat73]'",
    "csv": "CSV: a row of names, then rows of numbers between commas, semicolons or tabs",
}
"""Format to what a user calls it."""


def show(view: Iterable[RenderableType]) -> None:
    """Prints a view on stdout: as wide as the terminal, and without broken lines in a pipe."""
    console = Console(markup=False, highlight=False, emoji=False)
    if not console.is_terminal:
        console.width = _UNBROKEN
    for part in view:
        with console.capture() as captured:
            console.print(part)
        click.echo("\n".join(line.rstrip() for line in captured.get().split("\n")), nl=False)


def survey_view(survey: "Survey") -> View:
    """What is in a log, which cards fit, and what the flight is like."""
    tables = "1 table" if len(survey.tables) == 1 else f"{len(survey.tables)} tables"
    yield _title(f"{survey.path}: {survey.format}, {tables}")
    for table in survey.tables:
        yield _indented(_table_line(table))
        yield _indented(", ".join(table.columns), 4, "dim")
    yield from _list([f"{name}: not read: {reason}" for name, reason in survey.skipped.items()])
    yield from _list(survey.notes)
    if survey.recording:
        yield _indented(", ".join(f"{key} {text}" for key, text in survey.recording.items()))
    yield from _list([f"{since:.2f} s: {text}" for since, text in survey.events])
    yield _indented(f"Built-in cards that fit: {', '.join(survey.fitting) or 'none'}")
    if survey.flight:
        yield ""
        yield _title(f"Flight by the card {survey.card}")
        yield from _flight_view(survey.flight)
        for finding in survey.flight.findings:
            yield ""
            yield from _finding_view(finding)
    if survey.problem:
        yield _indented(f"No flight: {survey.problem}", 2, "yellow")


def _table_line(table: "TableSurvey") -> str:
    if table.rate is None:
        return f"{table.name}: {table.count} samples, no clock recognised"
    return f"{table.name}: {_rate(table.rate)}, by {table.time}"


def _rate(rate: Rate) -> str:
    """How regularly a stream was stamped, what is in order left out."""
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
    yield _indented(f"{flight.duration:.2f} s of flight in {len(parts)} segment{'s' * (len(parts) > 1)}: {shown} s")
    yield _indented(f"commands: {_rate(flight.command)}")
    yield _indented(f"poses: {_rate(flight.pose)}")
    fresh = f"{1 / flight.fresh.period:.4g} Hz" if flight.fresh.period else "no rate"
    yield _indented(f"stale poses: {100 * flight.stale_share:.1f} %; the fresh ones come at {fresh}")
    yield _indented(
        f"clocks: the poses start {_later(clocks.start_offset)} the commands and end {_later(clocks.end_offset)} them; "
        f"{clocks.overlap:.2f} s in common"
    )
    for name, drift in flight.recorder.items():
        yield _indented(
            f"recorder: {name} stamps are logged {1e3 * drift.offset:.3g} ms after the header's "
            f"({1e3 * drift.spread[0]:+.2g} to {1e3 * drift.spread[1]:+.2g} ms), drift {1e6 * drift.drift:.2g} us/s"
        )
    yield _excitation_table(flight.axes)
    yield from _list([note.text for note in flight.notes])


def _later(offset: float) -> str:
    return f"{abs(offset):.3f} s {'after' if offset >= 0 else 'before'}"


def _excitation_table(axes: "Iterable[Excitation]") -> RenderableType:
    table = _table("command", "not 0", "RMS", "lowest", "highest", "levels", "at ends", "95 % below")
    for axis in axes:
        table.add_row(
            axis.axis,
            f"{100 * axis.nonzero_share:.0f} %",
            *(f"{value:.3g}" for value in (axis.rms, axis.low, axis.high)),
            str(axis.levels),
            f"{100 * axis.extreme_share:.0f} %",
            "-" if axis.bandwidth is None else f"{axis.bandwidth:.2g} Hz",
        )
    return Padding(table, (0, 0, 0, 2), expand=False)


def model_view(model: Model, axes: Sequence[str]) -> View:
    """Verdict, coefficients, how sure the search is, repairs of the flights, findings."""
    wanted = [axis for axis in AXES if axis in axes]
    yield Text(summary_of_model(model, wanted))
    yield ""
    yield _coefficient_table(model, wanted)
    known = {axis: model.axes[axis] for axis in wanted if model.axes[axis].predictor}
    combined = any(axis.combinations for axis in known.values())
    lag = "lag + " if any("lag" in axis.extra for axis in known.values()) else ""
    legend = f"; steady gain = input / damping; total lag = delay + {lag}1 / damping" if combined else ""
    yield _indented(f"input is per command of 1{legend}", 0, "dim")
    yield from _list([line for axis, one in known.items() for line in _search_lines(axis, one)])
    if model.uncertainty:
        for heads, cells_of in ((PERCENT_HEADS, percent_rows), (ERROR_HEADS, error_rows)):
            yield ""
            table = _table(*heads, left=(0, 1), gap=1)
            for cells in cells_of(model.uncertainty):
                table.add_row(*cells)
            yield table
        yield from _list(accuracy_lines(model.uncertainty))
    rows = [row for row in physics_rows(model) if row.axis in wanted]
    if rows:
        yield ""
        yield _physics_table(rows)
        yield from _list([line for line in implied_limits(model) if line.partition(":")[0] in wanted])
    for axis, one in known.items():
        yield from _structure_view(axis, one)
    for flight in model.flights:
        yield ""
        start, end = flight.span
        yield _title(f"{flight.path}, {start:.2f} to {end:.2f} s, commands {', '.join(flight.axes) or 'nothing'}")
        yield from _list([note.text for note in flight.notes])
    concerned = [finding for finding in model.findings if finding.axis is None or finding.axis in wanted]
    for finding in concerned:
        yield ""
        yield from _finding_view(finding)


def _coefficient_table(model: Model, axes: Sequence[str]) -> RenderableType:
    table = _table(
        "axis", "coefficient", "estimate", "95 % interval", "unit", "paper", "status", left=(0, 1, 4, 6), gap=1
    )
    for axis in axes:
        known, k = model.axes[axis], AXES.index(axis)
        paper = dict(zip(COEFFICIENTS, model.paper[2 * k : 2 * k + 2], strict=False))
        there = [name for name in COEFFICIENTS if known.predictor or name == "input" or paper.get(name) is not None]
        for name in there:
            value, beside = getattr(known, name), paper.get(name)
            table.add_row(
                axis if name == "input" else "",
                name,
                "-" if value is None else _number(value, known.ci95[name]),
                _interval(known.ci95[name]),
                _UNITS[name][axis == "yaw"],
                "" if beside is None else f"{beside:.3g}",
                known.status[name],
            )
        for name, further in known.extra.items():
            ends, unit = known.ci95.get(name, (None, None)), _unit(axis, known.structure, name)
            value = "-" if further is None else _number(further, ends)
            table.add_row("", _words(name), value, _interval(ends), unit, "", known.status.get(name, "given"))
        for name, part in known.combinations.items():
            value = "-" if part.ci95 == (None, None) else _number(part.value, part.ci95)
            unit = _UNITS.get(name, ("", ""))[axis == "yaw"]
            table.add_row("", _words(name), value, _interval(part.ci95), unit, "", "")
    return table


def _physics_table(rows: Sequence[PhysicsRow]) -> RenderableType:
    """Coefficients in physics, at full command, beside what the card makes one expect."""
    table = _table("axis", "in physics", "estimate", "95 % interval", "unit", "expect", "ratio", left=(0, 1, 4), gap=1)
    shown = ""
    for row in rows:
        value, ends = row.measured.value, row.measured.ci95
        ratio = row.ratio if row.ratio and None not in row.ratio.ci95 else None
        table.add_row(
            "" if row.axis == shown else row.axis,
            row.name.replace("_", " "),
            "-" if value is None else _number(value, ends),
            _interval(ends),
            row.unit,
            "" if row.expected is None else f"{row.expected:.3g}",
            "" if ratio is None or ratio.value is None
            else f"{ratio.value:.2f} ({ratio.ci95[0]:.2f} to {ratio.ci95[1]:.2f})",
        )  # fmt: skip
        shown = row.axis
    return table


def _words(name: str) -> str:
    return name.replace("_", " ")


def _unit(axis: str, structure: str, name: str) -> str:
    """Unit of a further parameter of a structure."""
    unit = next(extra.unit for extra in structure_named(structure).extras if extra.name == name)
    speed = "rad/s" if axis == "yaw" else "m/s"
    return {"speed": speed, "gain": f"{speed}^2"}.get(unit, unit)


def _structure_view(axis: str, known: Axis) -> View:
    """The law of an axis where it is not the default, the default's coefficients, and what it was chosen from."""
    if known.plain:
        yield ""
        numbers = [
            f"{name} {'-' if value is None else _number(value, known.plain.ci95[name])}"
            f" ({_interval(known.plain.ci95[name])})"
            for name in COEFFICIENTS
            for value in (getattr(known.plain, name),)
        ]
        yield _title(f"{axis}: structure {known.structure}, {structure_named(known.structure).law}")
        yield _indented(f"With the default structure instead: {', '.join(numbers)}")
    if not known.candidates:
        return
    yield ""
    yield _title(f"{axis}: structures tried")
    scale, unit = (180 / math.pi, "deg") if axis == "yaw" else (100.0, "cm")
    table = _table("structure", "log L", "BIC", f"1 s [{unit}/s]", f"5 s [{unit}]", left=(0,))
    for one in known.candidates:
        errors = ["-" if e is None else _three_digits(scale * e) for e in (one.velocity, one.position)]
        mark = " *" if one.chosen else ""
        table.add_row(f"{one.structure}{mark}", f"{one.log_likelihood:+.1f}", f"{one.bic:+.1f}", *errors)
    yield table
    yield from _list([f"{one.structure}: {one.verdict}" for one in known.candidates if one.rival or not one.chosen])
    yield _indented("log L and BIC less the default's; errors of predictions of what was held out; * chosen", 0, "dim")


def _search_lines(axis: str, known: Axis) -> Iterator[str]:
    """How many starts of the search reached the chosen optimum, and what the others found."""
    starts = sum(mode.starts for mode in known.modes)
    for chosen in (mode for mode in known.modes if mode.chosen):
        yield f"{axis}: {chosen.starts} of {starts} starts of the search reached this optimum{_off(axis, chosen)}"
        for mode in (mode for mode in known.modes if not mode.chosen):
            above = mode.log_likelihood - chosen.log_likelihood
            stands = f"{abs(above):.0f} log units {'above' if above > 0 else 'below'}"
            yield f"{axis}: {mode.starts} ended {stands}, at a delay of {mode.delay:.3f} s{_off(axis, mode)}"


def _off(axis: str, mode: Mode) -> str:
    """What predicts the training flights, where that was judged."""
    if mode.prediction is None:
        return ""
    scale, unit = (180 / math.pi, "deg/s") if axis == "yaw" else (100.0, "cm/s")
    return f", 1 s predictions there off by {_three_digits(scale * mode.prediction)} {unit}"


def validation_view(validation: "Validation") -> View:
    """Errors of the model and of the baselines, flight by flight; whether they differ; what the residuals say."""
    yield from _scores_view({"model": validation.flights, **validation.baselines}, ("model",))
    yield ""
    yield from paired_view(validation.paired, [flight.path for flight in validation.flights])
    yield from residuals_view(validation)


def left_out_view(result: "LeaveOneOut", model: Model) -> View:
    """Every flight scored by a model of the others, and how far those models differ."""
    yield ""
    yield _title("Leave one out: each flight predicted by the model of the others")
    yield ""
    yield from _scores_view({"model": result.flights, **result.baselines}, ("model",))
    yield ""
    stated = {
        name: {**axis.stderr, **{key: _quarter(part.ci95) for key, part in axis.combinations.items()}}
        for name, axis in model.axes.items()
    }
    yield from leave_one_out_view(result, stated)


def _quarter(interval: Interval) -> float | None:
    """About the standard error behind a 95 % interval."""
    low, high = interval
    return None if low is None or high is None else (high - low) / 4


def comparison_view(comparison: "Comparison") -> View:
    """Errors of several models and of the baselines, flight by flight."""
    names = [f"model {number}" for number in range(1, len(comparison.paths) + 1)]
    yield from _list([f"{name}: {path}" for name, path in zip(names, comparison.paths, strict=True)])
    yield ""
    models = {name: each.flights for name, each in zip(names, comparison.validations, strict=True)}
    yield from _scores_view({**models, **comparison.validations[0].baselines}, tuple(models))
    yield ""
    yield from paired_view(comparison.paired, [flight.path for flight in comparison.validations[0].flights])
    yield from _list(comparison.notes)


def _scores_view(scores: Mapping[str, Sequence["FlightScores"]], models: Sequence[str]) -> View:
    flights = next(iter(scores.values()))
    for number, flight in enumerate(flights):
        start, end = flight.span
        rows = {name: each[number] for name, each in scores.items()}
        shown = [axis for axis in AXES if any(_has_scores(rows[name], axis) for name in models)]
        yield _title(f"{flight.path}, {start:.2f} to {end:.2f} s; heading {flight.heading}")
        horizons = list(flight.axes["x"].horizons)
        for first in range(0, len(horizons), _AT_ONCE):
            some = horizons[first : first + _AT_ONCE]
            if shown:
                yield _score_table(rows, shown, some)
        seen = [name for name in models if rows[name].fitted]
        if seen:
            yield _indented(f"No proof: {', '.join(seen)} was fitted to this stretch. Give a flight that was not.")
        missing = [axis for axis in AXES if axis not in shown]
        if missing:
            yield _indented(f"No scores of {', '.join(missing)}: no model of the axis, or fewer than 5 predictions.")
        yield ""
    yield Text(
        "v: RMSE of the predicted velocity over all steps up to the horizon [cm/s, yaw deg/s]; p: RMSE of the position "
        "at its end [cm, yaw deg]; fit: of 1 s velocity predictions; n: predictions. hold keeps the velocity of the "
        "start, paper uses the paper's coefficients.",
        style="dim",
    )


def _has_scores(scores: "FlightScores", axis: str) -> bool:
    return any(horizon.velocity_rmse is not None for horizon in scores.axes[axis].horizons.values())


def _score_table(rows: Mapping[str, "FlightScores"], axes: Sequence[str], horizons: Sequence[str]) -> RenderableType:
    heads = [f"{what} {horizon} s" for what in "vp" for horizon in horizons]
    table = _table("axis", "", *heads, "fit", left=(0, 1))
    for axis in axes:
        scale = 180 / math.pi if axis == "yaw" else 100.0
        for number, (name, flight) in enumerate(rows.items()):
            errors = [flight.axes[axis].horizons[horizon] for horizon in horizons]
            values = [*(error.velocity_rmse for error in errors), *(error.position_rmse for error in errors)]
            fit = flight.axes[axis].fit_percent
            cells = ["-" if value is None else _three_digits(scale * value) for value in values]
            table.add_row("" if number else axis, name, *cells, "-" if fit is None else f"{fit:.0f} %")
        counts = [next(iter(rows.values())).axes[axis].horizons[horizon].n for horizon in horizons]
        table.add_row("", "n", *(str(n) for n in counts), *[""] * (len(counts) + 1), style="dim")
    return table


def demo_view(demo: "Demo") -> View:
    """Truth beside the estimates, errors on the validation flights, and what was written."""
    from rotorfit.demo import recovered, scores

    table = _table("axis", "coefficient", "truth", "likelihood", "95 % interval", "", "paper's method", left=(0, 1, 5))
    rows = recovered(demo)
    for row in rows:
        axis, _, name = row.name.partition(".")
        table.add_row(
            axis if name == "input" else "",
            name,
            f"{row.truth:.4g}",
            "-" if row.ml is None else _number(row.ml, row.ci95),
            _interval(row.ci95),
            "" if _inside(row.truth, row.ci95) else "missed",
            "-" if row.paper is None else f"{row.paper:.3g}",
        )
    inside = sum(_inside(row.truth, row.ci95) for row in rows)
    yield _title("Six simulated flights, three to fit and three for the proof. What came back:")
    yield table
    yield _indented("input in m/s^2 (yaw rad/s^2) per command of 1, damping in 1/s, delay in s", 0, "dim")
    yield _indented(f"{inside} of {len(rows)} intervals hold the truth; of many, 95 % must.", 0)
    yield ""
    yield _title("1 s predictions of the velocity on flights that were not fitted:")
    errors = _table("axis", "likelihood", "paper's method", "velocity held", "flight", left=(0, 4))
    for score in scores(demo):
        scale = 180 / math.pi if score.axis == "yaw" else 100.0
        cells = ["-" if v is None else _three_digits(scale * v) for v in (score.ml, score.paper, score.hold)]
        errors.add_row(score.axis, *cells, Path(score.path).name)
    yield errors
    yield _indented("RMSE in cm/s (yaw deg/s); a velocity that is held is the naive prediction", 0, "dim")
    yield ""
    yield _title("Written:")
    yield from _list([str(path) for path in demo.written])


def _inside(value: float, interval: Interval) -> bool:
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


def cards_view(cards: Mapping[str, Card]) -> View:
    """Built-in cards: name, vehicle, columns."""
    for name, card in cards.items():
        yield _title(f"{name}: {card.name}")
        yield _indented(f"commands: {_columns({'time': card.command_time, **card.command})}")
        yield _indented(f"pose: {_columns({'time': card.pose_time, **card.pose})}")


def _columns(channels: Mapping[str, Channel]) -> str:
    """Columns with the table named once."""
    tables = {split_source(channel.source)[0] for channel in channels.values()}
    if len(tables) > 1:
        return ", ".join(str(channel.source) for channel in channels.values())
    names = ", ".join(split_source(channel.source)[1] for channel in channels.values())
    table = next(iter(tables))
    return f"{table}: {names}" if table else names


def formats_view(formats: Iterable[str]) -> View:
    """Formats of logs that can be read."""
    table = _table("format", "what it is", left=(0, 1))
    for name in formats:
        table.add_row(name, FORMATS[name])
    yield table
    yield Text("A format is found by content, not by name.", style="dim")


def _number(value: float, interval: Interval) -> str:
    """A number with the digits that its interval earns: two of the half width."""
    return f"{value:.{_decimals(value, interval)}f}"


def _interval(interval: Interval) -> str:
    low, high = interval
    if low is None and high is None:
        return "-"
    known = [end for end in interval if end is not None]
    decimals = _decimals(max(known, key=abs), interval)
    return " to ".join("open" if end is None else f"{end:.{decimals}f}" for end in interval)


def _decimals(value: float, interval: Interval) -> int:
    low, high = interval
    half = abs(value) / 10 if low is None or high is None else (high - low) / 2
    return max(0, min(6, 1 - math.floor(math.log10(half)))) if half > 0 else 3
