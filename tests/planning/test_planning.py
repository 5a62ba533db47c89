"""Plans that stay in their space, the next flight after a model, and the verb `plan`."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from models import VEHICLE, model_of
from rotorfit.app.cli import main
from rotorfit.app.terminal import show
from rotorfit.app.terminal.outlook import plan_view
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Plan, Sines, command_at
from rotorfit.core.frames import AXES
from rotorfit.core.model import Source
from rotorfit.diagnosis.doctor import SHORT_TIME
from rotorfit.files.cards import load_card
from rotorfit.files.models import save
from rotorfit.files.plans import load_plan
from rotorfit.planning.belief import belief_from_card, belief_from_model
from rotorfit.planning.envelope import ALLOWED, JUDGES, fleet_of, predicted_path
from rotorfit.planning.next_flight import next_flight, wanted_errors, worst_group
from rotorfit.planning.plan_flight import IDENT, band_of, full_amplitude, plan_flight, plan_flights
from rotorfit.planning.request import Request, space_of_box, space_of_room
from rotorfit.planning.request import planned as plans_of
from rotorfit.planning.signals import paper_sines

pytestmark = pytest.mark.flights

CARD = load_card("rotorfit-demo")
BELIEF = belief_from_card(CARD)
ROOM = space_of_room("6x4x3")


def frequencies(plan: Plan, axis: str) -> tuple[float, ...]:
    """Frequencies of an axis [rad/s]."""
    (one,) = (each.signal for each in plan.excitations if each.axis == axis)
    assert isinstance(one, Sines)
    return one.frequency


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def planned(*arguments: object) -> str:
    result = run("plan", *arguments)
    assert result.exit_code == 0, result.output
    return result.stdout


# Space


def test_a_room_keeps_its_margins_and_the_flight_starts_in_its_middle() -> None:
    assert (ROOM.lower, ROOM.upper) == ((-2.7, -1.7, 0.5), (2.7, 1.7, 2.7))
    assert ROOM.start == pytest.approx((0.0, 0.0, 1.6, 0.0))
    assert space_of_box("0,0,1,2,4,3").start == (1.0, 2.0, 2.0, 0.0)


@pytest.mark.parametrize(
    ("make", "text", "told"),
    [
        (space_of_room, "6x4", "not length x width x height"),
        (space_of_room, "0.6x4x3", "leaves no room"),
        (space_of_box, "1,2,3", "not x0,y0,z0,x1,y1,z1"),
        (space_of_box, "0,0,2,1,1,1", "leaves no room"),
    ],
)
def test_a_room_that_is_none_is_refused(make: Any, text: str, told: str) -> None:
    with pytest.raises(PlanError, match=told):
        make(text)


# Plans


def test_a_plan_stays_inside_says_what_it_tells_and_holds_what_it_does_not_fly() -> None:
    plan = plan_flight(CARD, ROOM, "multisine", ("z",), 15.0, BELIEF)
    assert plan.predicted["leaving"] <= 0.05
    assert set(plan.predicted["stderr"]) == {"z"}
    assert plan.feedback is not None
    assert {"x", "y", "yaw"} <= set(plan.feedback.axes)
    assert np.max(np.abs(command_at(plan, np.arange(0.0, 15.0, 0.01)))) <= full_amplitude(CARD, BELIEF, "z") * 1.001
    assert not command_at(plan, np.array([0.0, 14.99])).any()


def test_flights_that_leave_are_counted_with_the_side_beyond_which_the_middle_lies(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plan = plan_flight(CARD, ROOM, "multisine", ("z",), 15.0, BELIEF)
    for low, told in (
        (-9.0, "4 of 100 leave what is allowed, at low z at least; 5 % may."),
        (1.0, "allowed; 5 % may."),
    ):
        extent = {**plan.predicted["extent"], "z": [low, plan.space.upper[2] - 0.1]}
        show(plan_view(replace(plan, predicted={**plan.predicted, "leaving": 0.04, "extent": extent})))
        assert told in " ".join(capsys.readouterr().out.split())


def test_a_preview_says_for_which_law_its_errors_hold(capsys: pytest.CaptureFixture[str]) -> None:
    show(plan_view(plan_flight(CARD, ROOM, "multisine", ("z",), 15.0, BELIEF)))
    assert "expected errors are those of `fit --structure first_order_delay`" in capsys.readouterr().out.replace(
        "\n", " "
    )


def test_a_plan_is_judged_by_other_vehicles_than_those_with_which_its_amplitude_was_sought() -> None:
    plan = plan_flight(CARD, ROOM, "multisine", ("x", "y"), 20.0, BELIEF)
    shares = [
        predicted_path(plan, fleet_of(BELIEF, plan.rate, plan.duration, 400, seed)).leaving
        for seed in (10**7, 2 * 10**7)
    ]

    assert plan.predicted["draws"] == JUDGES
    assert plan.predicted["leaving"] <= ALLOWED
    assert np.mean(shares) <= 1.5 * ALLOWED  # a share of 5 % of 100 is known to 2.2 %


def test_an_open_loop_that_fits_is_left_open() -> None:
    plan = plan_flight(CARD, ROOM, "two_sines", ("yaw",), 15.0, BELIEF)
    assert plan.feedback is not None
    assert plan.feedback.axes == ("x", "y", "z")
    assert plan.predicted["notes"] == []


@pytest.mark.parametrize(("side", "centred"), [("6", True), ("99", False)])
def test_whether_there_is_feedback_does_not_hang_on_the_seed_and_a_drift_is_told(side: str, centred: bool) -> None:
    room = space_of_box(f"-{side},-{side},1,{side},{side},8")
    plans = [plan_flight(CARD, room, "multisine", ("x",), 30.0, BELIEF, amplitude=0.2, seed=seed) for seed in range(2)]

    assert {"x" in plan.feedback.axes for plan in plans if plan.feedback} == {centred}
    (note,) = plans[0].predicted["notes"]
    assert note.startswith(
        "soft feedback centres" if centred else "nothing centres the excited axes: a hover drifts up"
    )
    assert " m off along x" in note


def test_an_amplitude_that_leaves_is_refused_and_the_one_offered_is_flown() -> None:
    small = space_of_box("-0.8,-0.8,1,0.8,0.8,2")
    with pytest.raises(PlanError, match=r"plan doublets on x: .* leave the box along x.* give --amplitude") as refused:
        plan_flight(CARD, small, "doublets", ("x",), 12.0, BELIEF, amplitude=1.0)
    offered = float(str(refused.value).split("--amplitude ")[1].split(",")[0])
    plan = plan_flight(CARD, small, "doublets", ("x",), 12.0, BELIEF, amplitude=offered)
    assert plan.predicted["amplitude"] == {"x": offered}
    for far in (40.0, 1e9, 1e307):  # from far above it is the same, to the precision of the search
        with pytest.raises(PlanError) as refused:
            plan_flight(CARD, small, "doublets", ("x",), 12.0, BELIEF, amplitude=far)
        assert float(str(refused.value).split("--amplitude ")[1].split(",")[0]) == pytest.approx(offered, rel=0.05)


def test_a_room_larger_than_a_plan_holds_is_refused_with_what_to_give() -> None:
    with pytest.raises(PlanError, match=r"'100000x4x3' leaves 99999.4 m to fly: a plan has at most 500 m each way"):
        space_of_room("100000x4x3")


def test_open_loop_that_drifts_out_is_refused() -> None:
    with pytest.raises(PlanError, match=r"even the hover drifts out .* \(without --open-loop\)"):
        plan_flight(CARD, ROOM, "multisine", ("x",), 60.0, BELIEF, open_loop=True)


def test_axes_that_move_each_other_fly_on_odd_multiples_or_the_plan_says_what_may_come() -> None:
    """Tilt times thrust has the sums and differences of their frequencies: even multiples, that no axis flies."""
    long, short = (
        plan_flight(CARD, ROOM, "multisine", AXES, seconds, BELIEF, amplitude=0.2) for seconds in (60.0, 30.0)
    )
    base = 2 * np.pi / 58.0
    used = {axis: np.rint(np.array(frequencies(long, axis)) / base).astype(int) for axis in AXES}

    assert all(len(multiples) >= 4 and (multiples % 2 == 1).all() for multiples in used.values())
    assert len(set(np.concatenate(list(used.values())))) == sum(map(len, used.values()))
    assert not any("in so short a flight" in note for note in long.predicted["notes"])
    assert any("in so short a flight" in note for note in short.predicted["notes"])


def test_the_papers_sines_are_the_papers() -> None:
    plan = plan_flight(CARD, ROOM, "two_sines", ("x", "y"), 12.0, BELIEF, amplitude=1.0)
    assert [each.signal for each in plan.excitations] == [paper_sines("x"), paper_sines("y")]


def test_ident_flies_x_with_y_then_z_then_yaw_as_positions_under_the_gains_of_drone_dev() -> None:
    plan = plan_flight(CARD, ROOM, "ident", AXES, 32.0, BELIEF)
    assert plan.feedback == IDENT
    starts = {each.axis: each.start for each in plan.excitations}
    assert starts == {"x": 1.0, "y": 1.0, "z": 11.0, "yaw": 21.0}
    assert {each.target for each in plan.excitations} == {"position"}
    with pytest.raises(PlanError, match="needs its feedback"):
        plan_flight(CARD, ROOM, "ident", AXES, 32.0, BELIEF, open_loop=True)


def test_separate_flights_are_the_papers_groups() -> None:
    plans = plan_flights(CARD, ROOM, "two_sines", ("x", "z", "yaw"), 12.0, BELIEF, amplitude=1.0)
    assert [[each.axis for each in plan.excitations] for plan in plans] == [["x"], ["z"], ["yaw"]]


def test_the_band_ends_below_one_over_the_delay_and_begins_higher_in_a_smaller_room() -> None:
    low, high = band_of(BELIEF, ROOM, "x", 0.8)
    assert high == pytest.approx(0.7 / 0.15)
    assert band_of(BELIEF, space_of_room("3x3x3"), "x", 0.4)[0] > band_of(BELIEF, ROOM, "x", 0.4)[0]
    assert low < high
    late = replace(BELIEF, truth=replace(BELIEF.truth, delay=(0.3,) * 4))
    assert band_of(late, ROOM, "x", 0.8)[1] == pytest.approx(2.5)


def test_an_axis_that_reaches_its_velocity_at_once_is_commanded_as_far_as_its_velocity_allows() -> None:
    def commanded(damping: float) -> float:
        gamma = (*BELIEF.truth.gamma[:6], damping, damping)  # a steady gain of 1
        return full_amplitude(CARD, replace(BELIEF, truth=replace(BELIEF.truth, gamma=gamma)), "yaw")

    assert commanded(10.0) == pytest.approx(0.4)
    assert commanded(20.0) == commanded(200.0) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"design": "sweep"}, "no design 'sweep'; designs are two_sines"),
        ({"duration": 5.0}, "too short to identify anything"),
        ({"amplitude": 0.0}, "excites nothing"),
        ({"space": replace(ROOM, start=(9.0, 0.0, 1.0, 0.0))}, "is not inside the box"),
        ({"card": replace(CARD, command_frame="world")}, "heading frame only"),
        ({"card": replace(CARD, command={"x": CARD.command["x"]}), "axes": ("z",)}, "no command for z"),
    ],
)
def test_what_cannot_be_planned_is_refused_at_once(change: dict[str, Any], told: str) -> None:
    asked = {"card": CARD, "space": ROOM, "design": "multisine", "axes": ("x",), "duration": 20.0, "belief": BELIEF}
    with pytest.raises(PlanError, match=told):
        plan_flight(**(asked | change))


# The next flight


def test_the_next_flight_flies_what_is_worst_known_and_shrinks_it() -> None:
    model = model_of({axis: VEHICLE[axis] for axis in ("x", "y", "z")}, CARD, error=0.01)
    belief = belief_from_model(model, "m.json")
    proposal = next_flight(CARD, ROOM, belief, 20.0, design="multisine")
    assert [each.axis for each in proposal.plan.excitations] == ["yaw"]
    for name in ("input", "damping", "delay"):
        assert proposal.after["yaw"][name] < 0.3 * proposal.before["yaw"][name]
        assert proposal.after["x"][name] == pytest.approx(proposal.before["x"][name], rel=0.01)
    assert "of yaw is" in proposal.reason
    assert "all targets are met" not in proposal.reason
    known = belief_from_model(model_of(VEHICLE, CARD, error=0.001), "m.json")
    assert next_flight(CARD, ROOM, known, 20.0, design="multisine").reason.endswith("so no further flight is needed")


def test_other_axes_that_miss_targets_are_named_beside_the_worst_known() -> None:
    vague = belief_from_model(model_of(VEHICLE, CARD, error=0.08), "m.json")
    reason = next_flight(CARD, ROOM, vague, 20.0, design="multisine").reason
    first, *others = [axis for axis in AXES if f"{axis} is the worst known axis" in reason] or [reason.split(":")[0]]
    assert not others
    assert f"of {first} is " in reason
    flown = reason.split(":")[0].split(", ")
    told = ", ".join(axis for axis in AXES if axis not in flown)
    assert reason.endswith(f"; {told}: targets are missed, too, --axes plans for them")


def test_a_proposal_is_never_cut_to_what_a_fit_calls_short() -> None:
    known = belief_from_model(model_of(VEHICLE, CARD, error=0.001), "m.json")
    proposal = next_flight(CARD, ROOM, known, 40.0, design="multisine", axes=("z",))
    assert proposal.plan.duration == pytest.approx(30.0)
    assert proposal.plan.duration > SHORT_TIME
    assert proposal.reason.endswith("their targets are met, so no further flight is needed")


def test_the_worst_group_is_that_of_the_largest_ratio_among_the_commanded() -> None:
    ratio = np.ones(12)
    ratio[4] = 3.0
    assert worst_group(ratio, AXES) == ("x", "y")
    assert worst_group(ratio, ("x", "z")) == ("x",)
    ratio[8] = 5.0
    assert worst_group(ratio, AXES) == ("z",)


def test_what_is_wanted_follows_the_coefficients() -> None:
    wanted = wanted_errors(BELIEF).reshape(4, 3)
    np.testing.assert_allclose(wanted[0], [0.02 * BELIEF.truth.gamma[0], 0.05 * BELIEF.truth.gamma[1], 0.005])


# The command line


def test_a_plan_for_a_card_is_shown_written_drawn_and_read_again(tmp_path: Path) -> None:
    file, picture = tmp_path / "plan.toml", tmp_path / "plan.png"
    asked = ("--card", "rotorfit-demo", "--axes", "z", "--duration", 12, "-o", file, "--picture", picture)
    text = planned(*asked)
    assert "multisine on z: 12 s" in text
    assert "holds x, y, yaw" in text or "centres z" in text
    assert "+-" in text
    assert f"Written to {file}." in text
    plan = load_plan(file)
    assert plan.design == "multisine"
    assert tomllib.loads(file.read_text())["card"]["name"] == "rotorfit demo quadrotor"
    assert picture.read_bytes()[:4] == b"\x89PNG"
    planned(*asked)  # over its own earlier results
    named = run("plan", *asked[:-1], tmp_path / "plan.pdf")
    assert (named.exit_code, named.stdout) == (1, "")
    assert "plan.pdf: a picture is a PNG; name it plan.png" in named.stderr
    file.write_text(file.read_text().replace("rate = 50.0", "rate = 40.0"))
    refused = run("plan", *asked)
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert "is not as `rotorfit plan` wrote it: not overwritten" in refused.stderr
    assert load_plan(file).rate == 40.0


def test_a_room_that_nobody_named_is_told_wherever_the_plan_is() -> None:
    asked = ("--card", "rotorfit-demo", "--axes", "yaw", "--duration", 12, "--json")
    note = "no --room or --box: assumed is a room of 6x4x3 m, the origin in the middle of its floor"

    assert json.loads(planned(*asked))["plans"][0]["predicted"]["notes"][0] == note  # which the picture shows, too
    assert note not in planned(*asked, "--room", "6x4x3")


def test_the_json_is_the_plan_and_the_same_request_the_same_plan() -> None:
    asked = ("--card", "rotorfit-demo", "--axes", "yaw", "--duration", 12, "--design", "prbs", "--seed", 3, "--json")
    first = json.loads(planned(*asked))
    assert first["plans"][0]["design"] == "prbs"
    assert first["plans"][0]["path"] is None
    assert first["next"] is None
    assert json.loads(planned(*asked)) == first


def test_separate_plans_go_to_files_of_their_own(tmp_path: Path) -> None:
    asked = ("--axes", "z,yaw", "--duration", 12, "--design", "two_sines", "--amplitude", 1, "--separate")
    planned("--card", "rotorfit-demo", *asked, "-o", tmp_path / "plan.toml")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plan-yaw.toml", "plan-z.toml"]


def test_after_a_model_the_next_flight_is_shown_before_and_after(tmp_path: Path) -> None:
    save(model_of(card=CARD), tmp_path / "model.json")
    text = planned("--after", tmp_path / "model.json", "--duration", 12, "--design", "two_sines", "--axes", "yaw")
    assert "Next flight" in text
    assert "yaw: the axis asked for" in text
    assert "before" in text
    assert "quiet motion-capture room" not in text  # the model has noise and wind of its own
    result = json.loads(
        planned("--after", tmp_path / "model.json", "--duration", 12, "--design", "3211", "--axes", "z", "--json")
    )
    assert result["next"]["after"]["z"]["input"] < result["next"]["before"]["z"]["input"]


def test_a_model_of_commands_in_per_cent_is_asked_for_its_full_command() -> None:
    plain = replace(CARD.command["x"], meaning=None, full_scale=None, unit=None)
    model = model_of(card=replace(CARD, command={**CARD.command, "x": plain}))
    source = Source("sticks.csv", "0" * 64, (0.0, 60.0), axes=("x",), commanded={"x": 46.0})
    with pytest.raises(PlanError, match=r"commanded x up to 46, while a full command is 1 .* `scale = 0.01`"):
        plans_of(Request(after=replace(model, flights=(source,))))


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ((), "give --card with the limits of the vehicle, or --after"),
        (("--card", "rotorfit-demo", "--after", "cards.md"), "and not both"),
        (("--card", "rotorfit-demo", "--room", "6x4x3", "--box", "0,0,0,1,1,1"), "give --room or --box, not both"),
        (("--card", "rotorfit-demo", "--room", "big"), "is not length x width x height"),
        (("--card", "rotorfit-demo", "--speed", "-1"), "speed limits"),
        (("--card", "rotorfit-demo", "--room", "1000x1000x100"), "a plan has at most 500 m each way"),
        (("--card", "rotorfit-demo", "--room", "60x60x20", "--speed", "50"), "exceeds the limit 30"),
    ],
)
def test_mistakes_end_with_one_line(asked: tuple[str, ...], told: str, tmp_path: Path) -> None:
    (tmp_path / "cards.md").write_text("no model")
    result = run("plan", *(str(tmp_path / part) if part == "cards.md" else part for part in asked))
    assert result.exit_code == 1
    assert told in result.stderr
    assert result.stderr.count("\n") == 1
    assert result.stdout == ""


def test_a_plan_is_never_written_over_something_else(tmp_path: Path) -> None:
    (tmp_path / "flight.bag").write_bytes(b"a log")
    for option in ("-o", "--picture"):
        result = run("plan", "--card", "rotorfit-demo", option, tmp_path / "flight.bag")
        assert result.exit_code == 1
        assert "not overwritten" in result.stderr
    assert (tmp_path / "flight.bag").read_bytes() == b"a log"


def test_signals_of_a_plan_are_sines_where_the_design_is_a_multisine() -> None:
    plan = plan_flight(CARD, ROOM, "multisine", ("yaw",), 12.0, BELIEF, amplitude=0.5)
    assert isinstance(plan.excitations[0].signal, Sines)
