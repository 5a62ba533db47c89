"""Findings of a fit through the command line: each from a log that makes it true, with its numbers."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from flights import steps
from logs import CARD, Csv, ran, said
from rotorfit.core.frames import Array
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth, simulate_flight

pytestmark = pytest.mark.flights

TRUTH = replace(Truth(), stale_share=0.0)
Z = steps(("z",), seed=2)
WITHOUT_LAG = ("--structure", "first_order_delay")
"""Where a lag that may be there as well would hide what is asked."""

SLUGGISH = replace(TRUTH, gamma=(GAMMA_B[0], 0.05, *GAMMA_B[2:]), delay=(0.2,) * 4)


def flown(excitation: object = Z, duration: float = 40.0, truth: Truth = TRUTH) -> Csv:
    return Csv(simulate_flight(truth, excitation, duration, 5))  # type: ignore[arg-type]


def test_a_clean_fit_is_told_of_nothing(tmp_path: Path) -> None:
    assert said("fit", *flown().write(tmp_path)) == {}


def test_not_excited(tmp_path: Path) -> None:
    log = flown()
    log.command[:, 2] = steps(("z",), seed=51)(log.command_time)[:, 2]

    words = log.write(tmp_path)
    assert ("wind_dominates", "z") in said("info", *words)
    found = said("fit", *words)
    assert ("wind_dominates", "z") not in found  # as is said once, by the fit
    assert found["not_excited", "z"]["severity"] == "warning"


def test_too_short(tmp_path: Path) -> None:
    found = said("fit", *flown(duration=LEAST_TIME).write(tmp_path))

    assert found["too_short", "z"]["severity"] == "warning"


def test_damping_unstable_and_paper_damping_negative(tmp_path: Path) -> None:
    words = flown(partial(two_sines, axes=("x",)), 60.0, SLUGGISH).write(tmp_path)

    paper = said("fit", *words, "--method", "paper", "--axes", "x")
    damping = ran("fit", *words, "--method", "paper", "--axes", "x")["axes"]["x"]["damping"]
    assert paper["damping_unstable", "x"]["severity"] == "error"
    assert f"damping of {damping:.2g} 1/s" in paper["damping_unstable", "x"]["evidence"]
    beside = said("fit", *words, "--axes", "x", *WITHOUT_LAG)
    assert {code for code, _ in beside} <= {"paper_damping_negative", "damping_not_identifiable"}
    assert beside["paper_damping_negative", "x"]["severity"] == "info"
    assert f"damping of {damping:.2g} 1/s" in beside["paper_damping_negative", "x"]["evidence"]


@pytest.mark.parametrize(("late", "code"), [(0.2, "delay_negative"), (-0.5, "delay_at_bound")])
def test_clocks_apart(tmp_path: Path, late: float, code: str) -> None:
    log = flown()
    log.command_time = log.command_time + late

    found = said("fit", *log.write(tmp_path))[code, "z"]
    assert found["severity"] == ("error" if code == "delay_at_bound" else "warning")
    assert ("0.60 s" if code == "delay_at_bound" else "50 ms") in found["evidence"]
    assert "clock" in found["effect"] + found["remedy"]


def test_responses_before_their_commands_and_the_offset_that_the_remedy_gives(tmp_path: Path) -> None:
    log = flown()
    straight = ran("fit", *log.write(tmp_path))["axes"]["z"]
    log.command_time = log.command_time + 0.45

    (told,) = (one for (code, _), one in said("info", *log.write(tmp_path)).items() if code.startswith("response_"))
    assert (told["code"], told["axis"], told["severity"]) == ("response_before_command", None, "error")
    assert "z responds 0.25 s before" in told["evidence"]
    offset = told["remedy"].split("offset = ")[1].split()[0]
    card = CARD.replace('[command]\ntime = "time"', f'[command]\ntime = {{ from = "time", offset = {offset} }}')
    mended = ran("fit", *log.write(tmp_path, card))
    assert not {one["code"] for one in mended["findings"]} & {"response_before_command", "delay_negative"}
    assert mended["axes"]["z"]["input"] == pytest.approx(straight["input"], rel=1e-3)


@pytest.mark.parametrize("axis", [0, 2, 3])
def test_a_reversed_command_under_sines_is_no_delay_of_half_a_period(tmp_path: Path, axis: int) -> None:
    log = flown(two_sines, 60.0)
    log.command[:, axis] *= -1

    assert not {code for code, _ in said("info", *log.write(tmp_path)) if code.startswith("response_")}


def test_an_offset_of_the_sticks_that_the_card_does_not_say_and_its_remedy(tmp_path: Path) -> None:
    log = flown()
    log.command[:, 2] = 1500.0 + 400.0 * log.command[:, 2]
    card = CARD.replace('z = "cmd_z"', 'z = {{ from = "cmd_z", scale = 0.0025, offset = {} }}')

    told = said("fit", *log.write(tmp_path, card.format(0.0)))["zero_is_not_hover", "z"]
    assert told["severity"] == "warning"
    assert float(told["evidence"].split("at rest with ")[1].split()[0]) == pytest.approx(1500, abs=5)
    offset = float(told["remedy"].split("offset = ")[1].split()[0])
    assert offset == pytest.approx(-3.75, abs=0.02)
    assert ("zero_is_not_hover", "z") not in said("fit", *log.write(tmp_path, card.format(offset)))


def test_a_response_later_than_any_delay_that_is_searched(tmp_path: Path) -> None:
    log = flown()
    log.command_time = log.command_time - 0.7

    told = said("info", *log.write(tmp_path))["response_too_late", "z"]
    assert told["severity"] == "error"
    assert "z responds 0.90 s after" in told["evidence"]


def test_delay_and_damping_not_identifiable(tmp_path: Path) -> None:
    def slow(t: Array) -> Array:
        return np.stack([0 * t, 0 * t, 0.3 * np.sin(0.4 * t), 0 * t], axis=-1)

    truth = replace(TRUTH, wind_sigma=(0.05,) * 4)
    fitted = ran("fit", *flown(slow, 60.0, truth).write(tmp_path), *WITHOUT_LAG)
    found = {finding["code"]: finding for finding in fitted["findings"]}
    for name in ("delay", "damping"):
        assert fitted["axes"]["z"]["status"][name] == "not_identifiable"
        low, high = fitted["axes"]["z"]["ci95"][name]
        for end in (low, high):
            assert end is None or f"{end:.3g}" in found[f"{name}_not_identifiable"]["evidence"]


def test_input_not_identifiable(tmp_path: Path) -> None:
    truth = replace(TRUTH, gamma=(*GAMMA_B[:4], 100.0, 100.0, *GAMMA_B[6:]), pose_rate=10.0, mocap_noise=(0.02,) * 4)

    fitted = ran("fit", *flown(steps(("z",), 0.4, seed=3), 50.0, truth).write(tmp_path), *WITHOUT_LAG)
    found = {finding["code"]: finding for finding in fitted["findings"]}["input_not_identifiable"]
    gain = fitted["axes"]["z"]["combinations"]["steady_gain"]["value"]
    assert gain == pytest.approx(1.0, abs=0.05)
    assert f"{gain:.3g}" in found["effect"]


def test_weak_excitation(tmp_path: Path) -> None:
    truth = replace(TRUTH, wind_sigma=(0.02, 0.02, 0.6, 0.008))

    fitted = ran("fit", *flown(steps(("z",), 0.05, seed=2), 40.0, truth).write(tmp_path), *WITHOUT_LAG)
    found = {finding["code"]: finding for finding in fitted["findings"]}["weak_excitation"]
    axis = fitted["axes"]["z"]
    assert f"{100 * axis['stderr']['input'] / axis['input']:.0f} %" in found["evidence"]


def test_what_a_position_controller_moves_and_what_it_only_holds_on_a_real_flight(real_flights: Path) -> None:
    found = said("fit", str(real_flights / "bebop2-wsu" / "Training_CT_TestDay_X.mat"), *WITHOUT_LAG)

    assert {("feedback", "x"), ("not_excited", "y"), ("not_excited", "z"), ("not_excited", "yaw")} <= set(found)
    assert all(
        "only a response to the motion" in one["evidence"] for (code, _), one in found.items() if code == "not_excited"
    )


def test_no_command_is_asked_for_that_the_poses_could_not_show(real_flights: Path) -> None:
    found = said("fit", str(real_flights / "bebop2-wsu" / "Training_CT_TestDay_Z.mat"), "--axes", "z", *WITHOUT_LAG)

    assert found["slow_commands", "z"]["remedy"].startswith("use the steady gain and the total lag of z")


def test_real_flights_raise_no_finding_of_severity_error_before_the_fit(real_flights: Path) -> None:
    for name in ("bebop2-wsu", "bebop2-optitrack", "dji-hexarotor", "bebop2-joystick", "ardrone2-optitrack"):
        path = min(path for path in (real_flights / name).iterdir() if path.suffix != ".toml")
        findings = said("info", str(path)).values()
        assert [f["code"] for f in findings if f["severity"] == "error"] == [], path.name
        assert all(f["evidence"].startswith(str(path)) for f in findings)


def test_the_quirks_of_real_flights_are_told(real_flights: Path) -> None:
    def codes(path: str) -> set[tuple[str, str | None]]:
        return set(said("info", str(real_flights / path)))

    assert codes("bebop2-wsu/Training_CT_TestDay_X.mat") == {("wind_dominates", "yaw"), ("commands_by_row", None)}
    assert codes("bebop2-optitrack/monster_vert_tst.bag") == {("short_data", None), ("stale_poses", None)}
    assert codes("bebop2-joystick/record_velocity.csv") >= {("stale_poses", None), ("repeated_commands", None)}
    assert ("velocity_follows_command", "yaw") in codes("dji-hexarotor/Datos_Prueba5.mat")
    assert ("slow_commands", "yaw") in codes("dji-hexarotor/Datos_Prueba1.mat")
    ardrone = codes("ardrone2-optitrack/THETA_02_Feb_2022_11_49_20_LARANJA_COMPLETO.mat")
    assert ardrone >= {("stamp_jitter", None), ("short_data", None)}
    assert ("command_gaps", None) not in ardrone  # the gaps are short, and vehicles do not give up so soon
