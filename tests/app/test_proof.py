"""What the terminal says of paired tests, residuals and flights left out."""

from collections.abc import Iterable
from dataclasses import replace

from rich.console import Console, RenderableType

from rotorfit.app.terminal.proof import leave_one_out_view, paired_view, residual_line
from rotorfit.assessment.leave_one_out import LeaveOneOut
from rotorfit.core.residuals import ResidualTests
from rotorfit.core.results import Difference, FlightScores, LeftOut, Paired, PairedTest

BETTER = Difference(150, -0.0123, 0.002, 9.0, 1e-4, -1e-3, 2e-4, "better")
WORSE = Difference(150, 0.0456, 0.004, 9.0, 1e-4, 1e-3, 2e-4, "worse")
SHORT = Difference(6, -0.01, None, None, None, -1e-3, None, "too_short")


def told(view: Iterable[RenderableType], width: int = 80) -> str:
    console = Console(width=width, markup=False, highlight=False)
    with console.capture() as captured:
        for part in view:
            console.print(part)
    return captured.get()


def scores_of(*paths: str, moved: tuple[str, ...] = ("x", "yaw")) -> list[FlightScores]:
    return [FlightScores(path, (0.0, 60.0), {}, "measured", moved=moved) for path in paths]


def paired_of(
    *flights: Difference | None, pooled: Difference | None = None, agreement: float | None = None
) -> PairedTest:
    paired = Paired(flights, pooled, agreement)
    empty = Paired((None,) * len(flights), None, None)
    axes = {
        axis: {key: {"velocity": each, "position": each} for key in ("0.5", "1", "5")}
        for axis, each in (("x", paired), ("y", empty), ("z", empty), ("yaw", paired))
    }
    return PairedTest("model", "hold", axes)


def test_differences_are_told_with_interval_and_verdict_in_units_for_people() -> None:
    found = told(paired_view([paired_of(BETTER)], scores_of("dir/flight.bag")))

    assert "Is the difference real? flight.bag" in found
    assert "v 1 s" in found
    assert "p 5 s" in found
    lines = found.splitlines()
    assert any(line.startswith("x") and "-1.23 (-1.68 to -0.78) better" in line for line in lines)  # t of 9: 2.26
    assert any(line.startswith("yaw") and "-0.70 (-0.96 to -0.45)" in line for line in lines)
    assert not any(line.startswith(("y ", "z ")) for line in lines)
    assert "fitted" not in found


def test_an_axis_that_the_flight_does_not_move_is_not_shown() -> None:
    found = told(paired_view([paired_of(BETTER)], scores_of("flight.bag", moved=("x",))))

    assert "x    vs hold" in found
    assert "yaw " not in found.partition("Difference of")[0]


def test_several_flights_are_told_apart_and_together_and_a_contradiction_is_named() -> None:
    found = told(paired_view([paired_of(BETTER, WORSE, pooled=WORSE, agreement=1e-4)], scores_of("a.bag", "b.bag")))

    assert found.index("a.bag") < found.index("b.bag") < found.index("all flights")
    assert "better on some flights and worse on others" in found
    quiet = told(paired_view([paired_of(BETTER, BETTER, pooled=BETTER, agreement=1e-4)], scores_of("a.bag", "b.bag")))
    assert "worse on others" not in quiet


def test_a_flight_too_short_for_an_error_shows_the_difference_and_why() -> None:
    assert "-1.00 too short" in told(paired_view([paired_of(SHORT)], scores_of("a.bag")))


def test_flights_too_short_to_be_pooled_are_counted_by_horizon() -> None:
    test = paired_of(BETTER, SHORT, pooled=BETTER)
    x = test.axes["x"]["5"]
    test = replace(
        test, axes={**test.axes, "x": {**test.axes["x"], "5": {**x, "position": replace(x["position"], left_out=1)}}}
    )
    words = " ".join(told(paired_view([test], scores_of("a.bag", "b.bag"))).split())

    assert "too short for a standard error at 5 s, so not in the difference of all flights: 1 flight (x)" in words
    assert "at 1 s, so" not in words


def test_no_flight_and_no_test_show_nothing() -> None:
    assert told(paired_view([], [])) == ""


def test_the_line_of_an_axis_holds_all_three_verdicts() -> None:
    tests = ResidualTests(
        n=1000, lags=30, ljung_box=99.0, ljung_box_p=0.0, white_p=0.0012, command_freedom=9, command_p=0.41,
        command_peak=1.1, command_peak_lag=0.2, variance_ratio=1.52, variance_ci95=(1.31, 1.73),
        optimism={"input": 1.2}, white=False, follows_command=False,
    )  # fmt: skip

    expected = (
        "not white (p = 0.0012, 30 lags), free of past commands (p = 0.41), variance 1.5 of the fit's (1.3 to 1.7)"
    )
    assert residual_line(tests) == expected


def test_the_spread_stands_beside_what_the_fit_states() -> None:
    spread = (
        LeftOut("x", "damping", (1.0, 1.2), 1.0, 1.2, 0.1),
        LeftOut("x", "total_lag", (None, 0.5), 0.5, 0.5, None),
    )
    result = LeaveOneOut((), {}, (), spread, ("z: only one flight moves it",))

    found = told(leave_one_out_view(result, {"x": {"damping": 0.031}}))
    lines = [line.split() for line in found.splitlines()]
    assert ["x", "damping", "1", "1.2", "0.1", "0.031"] in lines
    assert ["total", "lag", "0.5", "0.5", "-", "-"] in lines
    assert "z: only one flight moves it" in found


def test_what_is_not_shown_has_an_interval_that_holds_zero_however_small_its_standard_error() -> None:
    """-20.6 with a standard error of 2.1 is ten of them, and with one degree of freedom no more than chance."""
    doubtful = Difference(60, -0.206, 0.021, 1.0, 0.065, -1e-3, 2e-4, "no_difference_shown")

    ends = doubtful.rmse_ci95
    assert ends is not None
    assert ends[0] < 0 < ends[1]
    assert "-21 (-47 to +6) none shown" in told(paired_view([paired_of(doubtful)], scores_of("flight.bag")))
    assert SHORT.rmse_ci95 is None


def test_on_a_flight_of_the_fit_a_difference_has_no_verdict() -> None:
    tests = [replace(paired_of(BETTER, WORSE), first=name) for name in ("model 1", "model 2")]
    found = told(paired_view(tests, scores_of("a.bag", "b.bag"), [("model 1",), ()]))
    first, second = found.split("b.bag")

    assert "a.bag; model 1 was fitted to it" in first
    assert "1 vs hold -1.23 (-1.68 to -0.78) fitted" in first
    assert "2 vs hold -1.23 (-1.68 to -0.78) better" in first
    assert "worse" in second
    assert "fitted" not in second.partition("Difference of")[0]
    assert "the model was fitted to it" in told(paired_view([paired_of(BETTER)], scores_of("a.bag"), [("model",)]))


def test_what_the_flights_of_a_fit_say_is_no_disagreement() -> None:
    """The first one does not count."""
    test = paired_of(BETTER, WORSE, WORSE, pooled=WORSE, agreement=1e-4)
    counted = {axis: {key: {what: replace(one, pooled_flights=(1, 2)) for what, one in both.items()}
               for key, both in each.items()} for axis, each in test.axes.items()}  # fmt: skip

    flights = scores_of("a.bag", "b.bag", "c.bag")
    assert "read them apart" in told(paired_view([test], flights))
    assert "read them apart" not in told(paired_view([replace(test, axes=counted)], flights))
