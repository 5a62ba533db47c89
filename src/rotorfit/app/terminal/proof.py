"""Terminal output of a validation: paired tests, residual tests, flights left out, in tables that fit 80 columns."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.padding import Padding
from rich.text import Text

from rotorfit.app.terminal.tables import NOTHING, View, bullets, finding_view, indented, table, three_digits, title
from rotorfit.assessment.rows import SPEED
from rotorfit.core.finding import told_together
from rotorfit.core.frames import AXES
from rotorfit.core.plain import listed
from rotorfit.core.residuals import ResidualTests, told_p
from rotorfit.core.results import named_apart, pool_lines

if TYPE_CHECKING:
    from rotorfit.assessment.leave_one_out import LeaveOneOut
    from rotorfit.core.error_bands import Coverage
    from rotorfit.core.results import Difference, FlightScores, PairedTest, Quantity, Validation

SHORT_HORIZON = "1"
"""Horizon at which velocities are compared in the table, if it was scored [s]."""

VERDICTS = {
    "better": "better",
    "worse": "worse",
    "no_difference_shown": "none shown",
    "too_short": "too short",
}
"""Verdict of a paired test to words that fit a column."""


def paired_view(
    tests: Sequence["PairedTest"], flights: Sequence["FlightScores"], fitted: Sequence[Collection[str]] = ()
) -> View:
    """Whether differences are significant: for each flight on the axes that it moves, and pooled if there are several.

    Args:
        tests: Paired tests on the flights.
        flights: Scores of the flights.
        fitted: Names of the predictors that were fitted to each flight: there a difference proves nothing.
    """
    if not tests or not any(tests[0].axes.values()):
        return
    keys = list(next(iter(tests[0].axes.values())))
    columns: list[tuple[Quantity, str]] = [
        ("velocity", SHORT_HORIZON if SHORT_HORIZON in keys else keys[0]),
        ("position", keys[-1]),
    ]
    names = named_apart(flights, folders=False)
    for number in range(len(flights) + (len(flights) > 1)):
        pooled = number == len(flights)
        out = table(
            "axis", "", *(h for what, key in columns for h in (f"{what[0]} {key} s", "")), left=(0, 1, 3, 5), gap=1
        )
        for axis in AXES if pooled else flights[number].moved:
            rows = [(t, [_found(t, axis, column, None if pooled else number) for column in columns]) for t in tests]
            some = [(test, found) for test, found in rows if any(each is not None for each in found)]
            for place, (test, found) in enumerate(some):
                name = f"vs {test.second}" if len({t.first for t in tests}) == 1 else f"{test.first} vs {test.second}"
                spent = not pooled and fitted and {test.first, test.second} & {*fitted[number]}
                cells = [cell for each in found for cell in _difference(each, axis, "fitted" if spent else "")]
                out.add_row("" if place else axis, name.replace("model ", ""), *cells)
        if out.row_count:
            where = "all flights that command the axis and were not fitted" if pooled else names[number]
            who = [] if pooled or not fitted else ["the model" if name == "model" else name for name in fitted[number]]
            told = f"; {listed(who)} {'was' if len(who) == 1 else 'were'} fitted to it" if who else ""
            yield title(f"Is the difference real? {where}{told}")
            yield out
    yield from _disagreements(tests, columns)
    yield from bullets(list(_left_out(tests, columns)))
    yield Text(
        "Difference of the RMSE on the same starts [cm/s, cm; yaw deg/s, deg], below 0: the first is better, with its "
        "95 % interval by Student's t: a short flight has few degrees of freedom; the word is the verdict"
        + (", or fitted: no proof, since one of the two was fitted to the flight" * any(fitted))
        + ".",
        style="dim",
    )


def _found(test: "PairedTest", axis: str, column: tuple["Quantity", str], flight: int | None) -> "Difference | None":
    what, key = column
    paired = test.axes[axis][key][what]
    return paired.pooled if flight is None else paired.flights[flight]


def _difference(found: "Difference | None", axis: str, instead: str) -> tuple[str, str]:
    """Figures and verdict, or another word instead of it."""
    if found is None:
        return "-", ""
    word = instead or VERDICTS[found.verdict]
    scale = SPEED[axis][1]
    ends, value = found.rmse_ci95, scale * found.rmse
    sign = "-" if value < 0 else "+"
    if ends is None or scale * (ends[1] - ends[0]) / 2 < NOTHING:
        return f"{sign}{three_digits(abs(value))}", word
    low, high = scale * ends[0], scale * ends[1]
    decimals = max(0, 1 - math.floor(math.log10((high - low) / 2)))  # two digits of the half width
    return f"{value:+.{decimals}f} ({low:+.{decimals}f} to {high:+.{decimals}f})", word


def _disagreements(tests: Sequence["PairedTest"], columns: Sequence[tuple["Quantity", str]]) -> View:
    """Cases in which the pooled difference hides that the first is better on one flight and worse on another."""
    for test in tests:
        for axis in AXES:
            for what, key in columns:
                paired = test.axes[axis][key][what]
                counted = [paired.flights[k] for k in paired.pooled_flights] or paired.flights
                verdicts = {found.verdict for found in counted if found}
                if paired.agreement is not None and paired.agreement < 0.05 and {"better", "worse"} <= verdicts:
                    yield from bullets(
                        [
                            f"{axis}, {test.first} vs {test.second}: better on some flights and worse on others in the "
                            f"{what} at {key} s (p = {paired.agreement:.2g} of no more than chance): read them apart"
                        ]
                    )


def _left_out(tests: Sequence["PairedTest"], columns: Sequence[tuple["Quantity", str]]) -> Iterator[str]:
    """How many flights are not in the pooled differences, and of which axes."""
    for what, key in columns:
        short = {axis: max(test.axes[axis][key][what].left_out for test in tests) for axis in AXES}
        for count in sorted({*short.values()} - {0}):
            axes = ", ".join(axis for axis in AXES if short[axis] == count)
            yield (
                f"too short for a standard error at {key} s, so not in the difference of all flights: "
                f"{count} flight{'s' * (count > 1)} ({axes})"
            )


def bands_view(validation: "Validation") -> View:
    """Width and coverage of the predicted 95 % and 50 % error bands, flight by flight."""
    names = named_apart(validation.flights, folders=False)
    for flight, name, axes in zip(validation.flights, names, validation.bands, strict=True):
        shown = [axis for axis in flight.moved if any(score.velocity for score in axes.get(axis, {}).values())]
        if not shown:
            continue
        yield ""
        yield title(f"Do the stated error bands hold? {name}")
        keys = list(axes[shown[0]])
        out = table("axis", "", *(f"{key} s" for key in keys), left=(0, 1))
        for axis in shown:
            for what in ("velocity", "position"):
                cells = [_band(getattr(axes[axis][key], what), axis) for key in keys]
                out.add_row(axis if what == "velocity" else "", what[0], *cells)
        yield out
    if any(validation.bands):
        yield Text(
            "Half width of the 95 % band [cm/s, cm; yaw deg/s, deg], share of the errors inside, and in brackets that "
            "inside the 50 % band. Bands are stated at the start, from the past of the flight alone.",
            style="dim",
        )


def _band(found: "Sequence[Coverage]", axis: str) -> str:
    if not found:
        return "-"
    half, wide = found
    scale = SPEED[axis][1]
    return f"{three_digits(scale * wide.width)} {100 * wide.coverage:.0f} % ({100 * half.coverage:.0f})"


def residuals_view(validation: "Validation") -> View:
    """The tests of the innovations, one line for each axis and flight, then the findings about the model."""
    for name, axes in zip(named_apart(validation.flights, folders=False), validation.residuals, strict=True):
        if axes:
            yield ""
            yield title(f"What the residuals say, {name}")
            yield from bullets([f"{axis}: {residual_line(tests)}" for axis, tests in axes.items()])
    for finding in told_together(one for one in validation.findings if one not in validation.before_scores):
        yield ""
        yield from finding_view(finding)


def residual_line(tests: "ResidualTests") -> str:
    """The tests of one axis in a line."""
    low, high = tests.variance_ci95
    parts = [f"{'white' if tests.white else 'not white'} ({told_p(tests.white_p)}, {tests.lags} lags)"]
    if tests.command_p is not None:
        does = "follow past commands" if tests.follows_command else "free of past commands"
        parts.append(f"{does} ({told_p(tests.command_p)})")
    parts.append(f"variance {tests.variance_ratio:.2g} of the fit's ({low:.2g} to {high:.2g})")
    return ", ".join(parts)


def leave_one_out_view(result: "LeaveOneOut", stated: Mapping[str, Mapping[str, float | None]]) -> View:
    """Tests against the baselines, and the spread of the coefficients; the scores are shown elsewhere.

    Args:
        result: Result of leaving out each flight in turn.
        stated: Axis name to coefficient to its standard error in the fit to all flights.
    """
    yield from paired_view(result.paired, result.flights)
    yield from bullets(pool_lines(result.flights, result.paired))
    yield ""
    yield title("Coefficients of the fits that leave out one flight")
    out = table("axis", "coefficient", "lowest", "highest", "jackknife s.e.", "stated s.e.", left=(0, 1))
    last = ""
    for spread in result.spread:
        own = stated.get(spread.axis, {}).get(spread.name)
        errors = ["-" if error is None else f"{error:.2g}" for error in (spread.jackknife_stderr, own)]
        cells = [f"{spread.low:.3g}", f"{spread.high:.3g}", *errors]
        out.add_row("" if spread.axis == last else spread.axis, spread.name.replace("_", " "), *cells)
        last = spread.axis
    yield Padding(out, (0, 0, 0, 0), expand=False)
    yield from bullets(result.notes)
    yield indented("A jackknife error far above the stated one: the flights differ by more than the noise.", 0, "dim")
