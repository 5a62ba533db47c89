"""The compositions: spans, logs, cards, fitting and validating from files, comparing, destinations."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rotorfit as rf
from flights import CARD, steps
from rotorfit.app.comparison import compare_logs, comparison_mapping
from rotorfit.app.workflows import (
    MODEL_MARK,
    REPORT_MARK,
    check_destination,
    fit_logs,
    load_flight,
    training_flights,
    validate_logs,
)
from rotorfit.assessment.validation import to_mapping, validate
from rotorfit.core.errors import FlightError, LogError, ModelError
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.estimation.fitting import fit, with_delay_profiles
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import WHOLE, LogSpan, parse_log, parse_span
from rotorfit.files.models import load, save
from rotorfit.simulation.paper_vehicle import Controller, Truth, simulate_flight, write_bag
from rotorfit.simulation.vehicle import load_vehicle


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two bags and a model of each by two methods."""
    place = tmp_path_factory.mktemp("pipeline")
    for name, seed in (("train", 1), ("other", 2)):
        write_bag(simulate_flight(Truth(), steps(("z", "yaw"), seed=seed), 20.0, seed), place / f"{name}.bag")
    logs = [LogSpan(str(place / "train.bag"), WHOLE)]
    save(fit_logs(logs, structure="first_order_delay").model, place / "ml.json")
    save(fit_logs(logs, method="paper").model, place / "paper.json")
    return place


def log(folder: Path, name: str, span: tuple[float | None, float | None] = WHOLE) -> LogSpan:
    return LogSpan(str(folder / f"{name}.bag"), span)


# Spans and logs


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("10:60", (10.0, 60.0)),
        (":84", (None, 84.0)),
        ("84:", (84.0, None)),
        (":", (None, None)),
        ("0:2.5", (0.0, 2.5)),
    ],
)
def test_a_span_is_two_numbers_either_of_which_may_be_left_out(
    text: str, span: tuple[float | None, float | None]
) -> None:
    assert parse_span(text) == span


@pytest.mark.parametrize("text", ["", "10", "a:b", "10:60:90", "60:10", "5:5", "1,5:2", "-5:10", ":-2"])
def test_what_is_no_span_is_refused_with_an_example_or_a_reason(text: str) -> None:
    with pytest.raises(LogError, match=r"T0:T1|T0 < T1"):
        parse_span(text)


def test_a_span_behind_the_log_is_its_own_and_a_file_of_that_name_wins(tmp_path: Path) -> None:
    default = (1.0, 2.0)

    assert parse_log("flight.bag@10:60", default) == LogSpan("flight.bag", (10.0, 60.0))
    assert parse_log("flight.bag", default) == LogSpan("flight.bag", default)
    assert parse_log("me@home/flight.bag", default) == LogSpan("me@home/flight.bag", default)
    odd = tmp_path / "flight@1:2"
    odd.write_text("")
    assert parse_log(str(odd), default) == LogSpan(str(odd), default)


def test_what_follows_the_at_of_a_file_that_is_there_must_be_a_span(tmp_path: Path) -> None:
    path = tmp_path / "flight.bag"
    path.write_text("")

    for text in (f"{path}@5", f"{path}+{path}@5"):
        with pytest.raises(LogError, match="span '5' is not T0:T1 in seconds"):
            parse_log(text)


# Reading and fitting


def test_a_log_is_read_with_the_card_that_fits_or_with_the_one_given(folder: Path) -> None:
    found, named, own = (load_flight(log(folder, "train"), card) for card in (None, "rotorfit-demo", CARD))

    assert found.card == named.card == own.card == CARD
    np.testing.assert_array_equal(found.position, named.position)


def test_the_span_reaches_the_flight(folder: Path) -> None:
    flight = load_flight(log(folder, "train", (5.0, 12.0)))

    assert flight.span == (5.0, 12.0)
    assert flight.pose_time[0] >= 5.0
    assert flight.pose_time[-1] <= 12.0


def test_fitting_logs_is_fitting_their_flights_with_the_findings_in_the_model(folder: Path) -> None:
    result = fit_logs([log(folder, "train")], axes=("z",))

    direct = with_delay_profiles(fit([load_flight(log(folder, "train"))], axes=("z",))).model
    assert result.model.axes == direct.axes
    assert result.model.paper == direct.paper
    assert {f.code for f in result.model.findings} >= {"stale_poses"}
    assert result.model.flights[0].path == str(folder / "train.bag")
    assert len(result.model.flights[0].sha256) == 64


def test_what_was_estimated_is_kept_for_who_draws(folder: Path) -> None:
    result = fit_logs([log(folder, "train")], axes=("z",))

    assert result.estimates["z"].excited
    assert result.flights[0].path == str(folder / "train.bag")


def test_a_model_is_validated_with_its_own_card(folder: Path) -> None:
    model = load(folder / "ml.json")

    validation, flights = validate_logs(model, [log(folder, "other")], horizons=(1.0,))
    assert flights[0].card.raw == model.card.raw
    assert to_mapping(validation) == to_mapping(validate(model, flights, (1.0,)))


def test_a_card_that_is_given_wins_over_the_models(folder: Path) -> None:
    model = load(folder / "ml.json")
    raw = json.loads(json.dumps(CARD.raw))
    raw["command"]["z"]["scale"] = -1
    flipped = card_from_mapping(raw, "flipped")

    good, _ = validate_logs(model, [log(folder, "other")], horizons=(1.0,))
    bad, _ = validate_logs(model, [log(folder, "other")], flipped, horizons=(1.0,))
    right, wrong = (v.flights[0].axes["z"].horizons["1"].velocity_rmse for v in (good, bad))
    assert right is not None
    assert wrong is not None
    assert wrong > 3 * right


# Comparing


def test_models_and_logs_may_come_in_any_order(folder: Path) -> None:
    ml, paper, other = (str(folder / name) for name in ("ml.json", "paper.json", "other.bag"))

    one, two = compare_logs([ml, paper, other], (1.0,)), compare_logs([other, ml, paper], (1.0,))
    assert one.paths == two.paths == (ml, paper)
    assert comparison_mapping(one) == comparison_mapping(two)


def test_a_comparison_is_each_models_validation(folder: Path) -> None:
    ml, paper, other = (str(folder / name) for name in ("ml.json", "paper.json", "other.bag"))

    raw = comparison_mapping(compare_logs([ml, paper, f"{other}@2:15"], (1.0,)))
    for entry in raw["models"]:
        alone, _ = validate_logs(load(entry["path"]), [log(folder, "other", (2.0, 15.0))], horizons=(1.0,))
        assert entry["flights"] == to_mapping(alone)["flights"]
    assert set(raw["baselines"]) == {"hold", "paper", "coast"}
    rmse = [entry["flights"][0]["axes"]["z"]["horizons"]["1"]["velocity_rmse"] for entry in raw["models"]]
    assert rmse[0] < rmse[1]


def test_a_comparison_in_a_position_loop_says_what_recorded_commands_reveal(folder: Path, tmp_path: Path) -> None:
    windy, loop = Truth(wind_sigma=(0.3, 0.3, 0.3, 0.3)), Controller(2.0, 2.5)
    path = tmp_path / "loop.bag"
    write_bag(simulate_flight(windy, steps(amplitude=0.1), 60.0, 3, controller=loop), path)
    models = [str(folder / "ml.json"), str(folder / "paper.json")]

    (note,) = comparison_mapping(compare_logs([*models, str(path)], (1.0, 5.0)))["notes"]
    assert "the commands of z and yaw seem to answer the motion" in note
    assert "gain a few per cent too low" in note
    assert comparison_mapping(compare_logs([*models, str(path)], (1.0,)))["notes"] == []


def test_progress_of_a_comparison_grows_over_all_models(folder: Path) -> None:
    told: list[float] = []

    compare_logs(
        [str(folder / name) for name in ("ml.json", "paper.json", "other.bag")],
        (1.0,),
        lambda fraction, _text: told.append(fraction),
    )
    assert told == sorted(told)
    assert told[0] < 0.5 <= told[-1] <= 1.0


def test_a_comparison_needs_a_model_and_a_log(folder: Path) -> None:
    with pytest.raises(ModelError, match="no model"):
        compare_logs([str(folder / "other.bag")])
    with pytest.raises(FlightError, match="no flight"):
        compare_logs([str(folder / "ml.json")])


# The training flights again


def test_the_training_flights_are_found_where_they_were(folder: Path) -> None:
    flights, left_out = training_flights(load(folder / "ml.json"))

    assert left_out == ()
    assert [flight.path for flight in flights] == [str(folder / "train.bag")]


def moved(model: Model, **parts: object) -> Model:
    return replace(model, flights=(replace(model.flights[0], **parts),))  # type: ignore[arg-type]


def test_a_training_log_that_is_gone_or_another_is_left_out_with_a_line(folder: Path) -> None:
    model = load(folder / "ml.json")

    for other, said in (
        (moved(model, path=str(folder / "gone.bag")), "gone.bag"),
        (moved(model, path=str(folder / "other.bag")), "not the file"),
        (moved(model, sha256="0" * 64), "not the file"),
    ):
        flights, left_out = training_flights(other)
        assert flights == ()
        (line,) = left_out
        assert said in line
        assert "\n" not in line


def test_the_span_of_the_training_is_kept(folder: Path) -> None:
    model = fit_logs([log(folder, "train", (2.0, 14.0))], axes=("z",)).model

    (flight,), _ = training_flights(model)
    assert flight.span == (2.0, 14.0)
    assert model.flights[0].span == (2.0, 14.0)


# Destinations


def test_nothing_is_written_over_what_is_not_an_earlier_result(folder: Path, tmp_path: Path) -> None:
    check_destination(tmp_path / "new.json", MODEL_MARK)
    os.mkfifo(tmp_path / "pipe")
    check_destination(tmp_path / "pipe", MODEL_MARK)
    check_destination(folder / "ml.json", MODEL_MARK)
    page = tmp_path / "report.html"
    page.write_text("<!DOCTYPE html><title>x")
    check_destination(page, REPORT_MARK)

    for path, mark in (
        (folder / "train.bag", MODEL_MARK),
        (folder / "ml.json", REPORT_MARK),
        (page, MODEL_MARK),
        (tmp_path, MODEL_MARK),
        (tmp_path / "no" / "model.json", MODEL_MARK),
    ):
        with pytest.raises(LogError, match=path.name):
            check_destination(path, mark)


def test_the_model_of_a_bag_knows_its_axes(folder: Path) -> None:
    model = load(folder / "ml.json")

    assert [model.axes[axis].status["input"] for axis in AXES] == ["not_excited", "not_excited", "ok", "ok"]
    assert model.flights[0].axes == ("z", "yaw")


def test_a_heading_that_a_flight_only_holds_is_not_published(tmp_path: Path) -> None:
    """Its commands answer gusts, and tell of the motion to come: the fit was an input of 18 to 32 instead of 4.4."""
    vehicle = load_vehicle("bebop2")
    plan = rf.plan(
        card_from_mapping(vehicle.card(), vehicle.name),
        design="multisine", axes="x,y", room="6x6x4", duration=30.0, seed=3,
    )  # fmt: skip
    rf.fly(plan, "sim:bebop2,gusts=0.2", tmp_path / "flight.mcap", seed=3)
    model = rf.fit(tmp_path / "flight.mcap", axes=("yaw",), structure="first_order_delay").model

    assert model.axes["yaw"].status["input"] == "not_excited"
