"""What the terminal shows: numbers with the digits that they earn, open ends, and what has no numbers."""

import io
import math
import re
from dataclasses import replace
from itertools import pairwise

import pytest
from rich.console import Console
from test_summary import axis, model

from rotorfit.app.terminal import show
from rotorfit.app.terminal.coefficients import model_view
from rotorfit.app.terminal.tracking import alarm_view, line_of, news, track_view
from rotorfit.core.display import interval_text, number_text
from rotorfit.core.frames import AXES
from rotorfit.core.model import Combination, Evidence, Mode, Model, Spread
from rotorfit.core.tracked import UNMOVED, Air, Alarm, Regime, Track, Tracked, TrackedAxis


def rows_of(shown: Model, capsys: pytest.CaptureFixture[str]) -> dict[str, list[str]]:
    """Cells of the table of coefficients of x, by coefficient."""
    show(model_view(shown, ("x",)))
    lines = capsys.readouterr().out.partition("───\n")[2].partition("input is per")[0].splitlines()
    rows = [re.sub(" to ", "..", line.removeprefix("x")).strip() for line in lines]
    return {row[:11].strip(): row[11:].split() for row in (f"{row:<12}" for row in rows)}


def test_estimates_have_two_digits_of_their_interval(capsys: pytest.CaptureFixture[str]) -> None:
    ends = {"input": (3.9012, 4.0988), "damping": (0.14, 0.26), "delay": (0.0951, 0.1049)}

    rows = rows_of(model({"x": replace(axis(), ci95=ends)}), capsys)

    assert rows["input"] == ["4.000", "3.901..4.099", "m/s^2", "ok"]
    assert rows["damping"] == ["0.200", "0.140..0.260", "1/s", "ok"]
    assert rows["delay"] == ["0.1000", "0.0951..0.1049", "s", "ok"]


def test_open_ends_and_unknown_coefficients_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    unknown = axis({"steady_gain": Combination(1256.0, (None, None))}, damping="not_identifiable")
    ends = {**unknown.ci95, "damping": (None, 0.487)}

    rows = rows_of(model({"x": replace(unknown, damping=None, ci95=ends)}), capsys)

    assert rows["damping"] == ["-", "open..0.487", "1/s", "not_identifiable"]
    assert rows["steady gain"] == ["-", "-", "m/s"]


def test_a_delay_that_the_law_does_not_have_is_given_and_not_measured(capsys: pytest.CaptureFixture[str]) -> None:
    ends = {**axis().ci95, "delay": (0.0, 0.0)}

    rows = rows_of(model({"x": replace(axis(), structure="first_order", delay=0.0, ci95=ends)}), capsys)

    assert rows["delay"] == ["0", "by", "the", "law", "s", "given"]


def test_several_flights_tell_every_coefficient_on_the_next_one(capsys: pytest.CaptureFixture[str]) -> None:
    of_flights = Spread("flights", 0.1, 0.1, 0.1, 2, 0.5, (3.5, 4.5), True)
    spread = {"input": of_flights, "steady_gain": replace(of_flights, next_flight=(None, 21.0))}
    known = replace(axis({"steady_gain": Combination(20.0, (19.5, 20.5))}), spread=spread)

    show(model_view(model({"x": known}), ("x",)))
    assert "x on the next flight, 95 %: input 3.50 to 4.50, steady gain open to 21" in capsys.readouterr().out
    one = {name: replace(each, source="prior") for name, each in spread.items()}
    show(model_view(model({"x": replace(known, spread=one)}), ("x",)))
    assert "next flight" not in capsys.readouterr().out


def test_in_80_columns_no_word_of_the_coefficients_is_broken() -> None:
    ends, told = (0.1855, 0.1953), Combination(0.1902, (0.1855, 0.1953), (0.1870, 0.1938))
    known = replace(axis({"delay_plus_lag": told}, damping="not_identifiable"), damping=None)
    known = replace(known, ci95=dict.fromkeys(known.ci95, ends), ci95_flight=dict.fromkeys(known.ci95, ends))
    shown = replace(model({"yaw": known}, flights=2), paper=(None,) * 6 + (4.0, 2.0))

    def lines(width: int) -> list[str]:
        console = Console(width=width, file=io.StringIO(), no_color=True)
        with console.capture() as capture:
            console.print(*model_view(shown, ("yaw",)), sep="\n")
        return capture.get().splitlines()

    narrow = "\n".join(lines(80)).partition("input is per")[0]
    assert {"coefficient", "damping", "not", "identifiable", "rad/s^2", "0.1870", "to", "flights"} <= {*narrow.split()}
    assert "paper" not in narrow
    assert any(re.search(r"yaw +input .* ok *$", line) for line in narrow.splitlines())
    wide = "\n".join(lines(120))
    assert {"paper", "not_identifiable"} <= {*wide.split()}


def test_the_papers_coefficients_stand_beside_even_where_the_likelihood_has_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = rows_of(replace(model({}), paper=(4.33, -0.23, *[None] * 6)), capsys)

    assert rows == {
        "input": ["-", "-", "m/s^2", "4.33", "not_excited"],
        "damping": ["-", "-", "1/s", "-0.23", "not_excited"],
    }


def test_names_that_look_like_markup_are_shown_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    plain = model({"x": axis()})
    odd = replace(plain, flights=(replace(plain.flights[0], path="[red]:smile:.bag"),))

    show(model_view(odd, ("x",)))

    assert "[red]:smile:.bag, 0.00 to 30.00 s" in capsys.readouterr().out


def test_other_delays_are_told_in_one_line_an_axis_and_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    chosen = Mode(0.178, 2.3, 4.0, -3.0, 2, 0.02, chosen=True)
    others = {
        "as likely": Mode(0.216, 2.5, 4.0, -3.4, 3, 0.02, chosen=False),
        "less likely": Mode(0.3, 2.5, 4.0, -6.0, 3, 0.02, chosen=False),
        "more likely, but predicts 2.0 times worse": Mode(0.012, 90.0, 80.0, 0.0, 1, 0.04, chosen=False),
    }
    far = Mode(0.5, 2.5, 4.0, -60.0, 3, 0.02, chosen=False)
    several = replace(axis(), modes=(chosen, *others.values(), far))
    lone = replace(axis(), modes=(chosen, far))

    show(model_view(model({"x": lone, "y": lone, "z": several}), ("x", "y", "z")))

    lines = [line for line in " ".join(capsys.readouterr().out.split()).split(" - ") if "other delay" in line]
    assert lines[0] == (
        "z: other delays fit almost as well: 0.012 s (more likely, but predicts 2.0 times worse), "
        "0.216 s (as likely), 0.300 s (less likely)"
    )
    assert lines[1].startswith("x, y: no other delay was found that fits nearly as well")


def test_what_was_tracked_stands_with_its_units(capsys: pytest.CaptureFixture[str]) -> None:
    values = {"input": 5.0, "damping": 0.5, "delay": 0.1, "steady_gain": 10.0}
    one = TrackedAxis("known", "known", values, dict.fromkeys(values, (0.9, 1.1)), wind=0.1)
    show(track_view(Track((Tracked(12.0, {"x": one, "yaw": one}),), ())))
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]

    shown = [row[-4] for row in rows if "to" in row and {"input", "gain"} & set(row)]
    assert shown == ["m/s^2", "m/s", "rad/s^2", "rad/s"]


@pytest.mark.parametrize(
    ("air", "said"),
    [
        (Air(0.01, (0.0, 0.031), 2.8, (-0.3, 5.9)), "Mean wind below 0.031 m/s"),
        (Air(0.01, (0.001, 0.031), 1.0, (1.0 - math.pi, 1.0 + math.pi)), "Mean wind below 0.031 m/s"),
        (
            Air(2.0, (1.8, 2.2), -0.001, (-0.1, 0.1)),
            "Mean wind 2.00 m/s (1.80 to 2.20), towards 0 deg (-6 to 6) from the world's x, counter-clockwise",
        ),
    ],
)
def test_still_air_blows_nowhere(capsys: pytest.CaptureFixture[str], air: Air, said: str) -> None:
    show(track_view(Track((Tracked(12.0, {"x": TrackedAxis()}, air=air),), ())))
    lines = " ".join(capsys.readouterr().out.split())

    assert lines.endswith(said)
    assert "per command of 1" not in lines


def test_the_end_of_a_track_says_from_when_on_each_axis_was_watched(capsys: pytest.CaptureFixture[str]) -> None:
    axes = {name: TrackedAxis(watched=time) for name, time in zip(AXES, (9.0, 9.0, 12.3, None), strict=True)}
    show(track_view(Track((Tracked(20.0, axes),), ())))

    assert "Watched for changes: x, y from 9.0 s on; z from 12.3 s on; yaw never\n" in capsys.readouterr().out


def test_an_axis_that_changed_is_watched_anew_and_the_end_says_both_times(capsys: pytest.CaptureFixture[str]) -> None:
    moments = ((9.0, None), (10.0, 9.5), (20.0, 9.5), (20.5, None), (32.0, 31.5), (40.0, 31.5))
    states = tuple(Tracked(time, {"z": TrackedAxis("known", "known", watched=since)}) for time, since in moments)
    show(track_view(Track(states, ())))
    assert "Watched for changes: z from 9.5 s to 20.5 s and from 31.5 s on\n" in capsys.readouterr().out

    told = [[str(line) for line in news(*pair)] for pair in pairwise(states)]
    begins = "  z    watched for changes from here on"
    assert told == [[f"    9.5 s{begins}"], [], [], [f"   31.5 s{begins}"], []]
    assert line_of(states[0]) == "9 s: z known; not yet watched for changes: z  (Ctrl-C ends)"
    assert line_of(states[1]) == "10 s: z known  (Ctrl-C ends)"
    assert Tracked(9.0, {"yaw": TrackedAxis("not_excited", UNMOVED)}).unwatched == ()


def test_an_axis_that_hard_commands_of_others_leave_untested_is_hardly_watched(
    capsys: pytest.CaptureFixture[str],
) -> None:
    moments = ((11.0, None, 0.9), (12.0, 11.5, 0.3), (13.0, 11.5, 0.6), (14.0, 11.5, 0.6))
    states = tuple(
        Tracked(time, {"z": TrackedAxis("known", "known", watched=since, untested=share, untested_in_all=0.45)})
        for time, since, share in moments
    )
    show(track_view(Track(states, ())))
    told = "z from 11.5 s on (45% of the time untested: x and y were commanded hard)"
    assert f"Watched for changes: {told}" in " ".join(capsys.readouterr().out.split())

    hardly = "   13.0 s  z    hardly watched: x and y are commanded hard, 60% of the last 40 s not tested for changes; "
    hardly += "smaller or rarer steps of x and y would have it watched"
    assert [[str(line) for line in news(*pair)] for pair in pairwise(states)][1:] == [[hardly], []]
    assert states[-1].blind == "hardly watched, x and y are commanded hard: z"


def test_another_law_is_told_when_it_comes_and_once_more_where_it_came_at_the_end(
    capsys: pytest.CaptureFixture[str],
) -> None:
    values = {"input": 5.0, "damping": 0.5, "delay": 0.1}
    lagged, plain = (
        TrackedAxis("known", "known", values, dict.fromkeys(values, (0.0, 9.0)), structure=law)
        for law in ("first_order_delay_lag", "first_order_delay")
    )
    states = Tracked(11.0, {"x": plain}), Tracked(12.0, {"x": lagged}), Tracked(12.4, {"x": plain}, landed=True)
    lines = [str(line) for pair in pairwise(states) for line in news(*pair)]
    assert lines[0].startswith("   12.0 s  x    known (law first_order_delay_lag, before first_order_delay): ")
    assert lines[1].startswith("   12.4 s  x    known (law first_order_delay, before first_order_delay_lag): ")

    show(track_view(Track(states, ())))
    said = "x: the last fit is under law first_order_delay, numbers told before it are under first_order_delay_lag"
    assert said in " ".join(capsys.readouterr().out.split())
    assert Track(states[:2], ()).laws_at_end == ()
    assert Track((states[0], replace(states[2], axes={"x": replace(plain, earlier="a.json")})), ()).laws_at_end == ()


def test_an_axis_that_drifts_without_an_alarm_is_told_of_at_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    drifting = Evidence("quarter", "quarters of long flights do not agree, most about the input", 3e-9, {"input": 0.1})
    states = (Tracked(200.0, {"z": TrackedAxis("known", "known")}),)
    drifted = model({"z": replace(axis(), evidence=(drifting, replace(drifting, test="size")))})
    show(track_view(Track(states, (Regime(0.0, 200.0, drifted),))))

    said = " ".join(capsys.readouterr().out.split())
    assert "z: quarters of long flights do not agree, most about the input (p = 3e-09), yet no seconds" in said
    assert Track(states, (Regime(0.0, 200.0, model({"z": axis()})),)).drifts == ()


def test_the_zero_of_a_law_stands_beside_the_lag_that_it_shortens(capsys: pytest.CaptureFixture[str]) -> None:
    values = {"damping": 2.0, "delay": 0.1, "lag": 0.2, "zero": 0.3, "total_lag": 0.3}
    one = TrackedAxis("known", "known", values, dict.fromkeys(values, (0.0, 1.0)), structure="second_order_zero")
    show(track_view(Track((Tracked(12.0, {"x": one}),), ())))
    rows = [line.split()[-6:-3] for line in capsys.readouterr().out.splitlines() if " s " in line]

    assert ["zero", "0.30", "s"] in rows
    assert one.to_mapping()["zero"] == 0.3


def test_nothing_is_less_than_zero() -> None:
    assert number_text(-0.001, (-0.2, 0.2)) == "0.00"
    assert interval_text((-0.001, 0.2)) == "0.00 to 0.20"
    assert interval_text((0.509, 284.0)) == "0.5 to 284"
    assert interval_text((-284.0, -0.509)) == "-284 to -0.5"
    assert interval_text((0.0014, 2.6)) == "0.001 to 2.6"


def test_the_mean_wind_is_told_where_it_begins_and_where_it_ends(capsys: pytest.CaptureFixture[str]) -> None:
    begun = Tracked(21.0, {}, air=Air(2.1, (1.6, 2.8), 0.0, (-0.1, 0.1)))
    before, after = Tracked(20.0, {}), Tracked(22.0, {})
    for one, other in ((before, begun), (begun, begun), (begun, after), (after, after)):
        show(news(one, other))

    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("   21.0 s  air  Mean wind 2.10 m/s (1.60 to 2.80), towards 0 deg")
    assert second == "   22.0 s  air  x and y are no longer known well enough for the wind"


def test_an_alarm_gives_times_as_differences_and_no_instant_to_what_was_so_from_the_start(
    capsys: pytest.CaptureFixture[str],
) -> None:
    change = {"z.total_lag": (-0.206, -0.195), "z.steady_gain": (0.8, 0.9)}
    show(alarm_view(Alarm(6.0, ("z",), "another_vehicle", (0.0, 0.0), change, 1.0, 1e-9, "because")))

    out = capsys.readouterr().out
    assert "z total lag by -0.206 to -0.195 s; z steady gain times 0.8 to 0.9." in out
    assert "since" not in out


def test_a_revised_alarm_cannot_be_taken_for_a_new_one(capsys: pytest.CaptureFixture[str]) -> None:
    first = Alarm(6.25, ("z",), "payload", (6.0, 6.2), {}, 0.9, 1e-9, "because")
    show(alarm_view(first))
    show(alarm_view(replace(first, time=7.25, axes=("z", "yaw"), cause="thrust", revises=6.25)))

    heads = [line for line in capsys.readouterr().out.splitlines() if "since" in line]
    assert heads[0].startswith("   6.25 s  ALARM z: payload, since")
    assert heads[1].startswith("   7.25 s  REVISED z, yaw: thrust, alarm of 6.25 s, since")


def test_a_line_says_that_a_flight_contradicts_the_earlier_model(capsys: pytest.CaptureFixture[str]) -> None:
    values = {"input": 2.5}
    then = TrackedAxis("not_identifiable", "not identifiable (until then from a.json)", values, earlier="a.json")
    now = replace(then, state="not identifiable (contradicts a.json: input)", earlier="", contradicts=("input",))
    states = [Tracked(time, {"x": replace(one, ci95={"input": (2.4, 2.6)})}) for time, one in ((8.0, then), (9.0, now))]
    for line in news(*states):
        show([line])

    assert "9.0 s  x    not identifiable (contradicts a.json: input): input 2.5" in capsys.readouterr().out
    assert not list(news(states[1], states[1]))
