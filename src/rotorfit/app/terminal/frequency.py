"""Terminal output of frequency responses: the flight's beside the model's, in tables that fit 80 columns."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rotorfit.app.terminal.tables import View, bullets, indented, table, title
from rotorfit.core.results import named_apart

if TYPE_CHECKING:
    from rotorfit.core.frequency_response import ResponseComparison
    from rotorfit.core.results import FlightScores


def responses_view(responses: Sequence[Mapping[str, "ResponseComparison"]], flights: Sequence["FlightScores"]) -> View:
    """Gain and delay at each frequency, flight by flight, and the result of the test of the law.

    Args:
        responses: Axis name to its response, for each flight.
        flights: Scores of the same flights, for their paths.
    """
    from rotorfit.reporting.frequency import response_line, response_rows

    for name, axes in zip(named_apart(flights, folders=False), responses, strict=False):
        if not axes:
            continue
        yield ""
        yield title(f"Frequency response, {name}")
        out = table("axis", "rad/s", "gain", "95 %", "model", "ms", "95 %", "model", "coh.", gap=1)
        for axis, each in axes.items():
            for number, row in enumerate(response_rows(each)):
                out.add_row("" if number else axis, *row)
        if out.row_count:
            yield out
        yield from bullets([f"{axis}: {response_line(each)}" for axis, each in axes.items()])
    if any(responses):
        yield indented(
            "Velocity per command, and its delay, from the flight alone, with 95 % bands; *: the model is outside.",
            0,
            "dim",
        )
