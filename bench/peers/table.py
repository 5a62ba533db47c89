"""The table of the benchmark, for the terminal and for the documentation."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

NAMES = ("hold", "paper", "coast", "PySINDy", "SysIdentPy", "N4SID", "statsmodels", "ml", "auto", "truth")
SIGNS = {"better": "+", "no_difference_shown": "=", "worse": "-", "too_short": "?"}

RAN_AWAY = 1e3
"""An error that no vehicle can have [m, m/s; rad]: an unstable model, which no average of squares describes."""

EXPLAINED = """Everybody fits the same training flights and predicts the same test flights by
[one protocol](method.md#prediction-and-scores): 2 s to find the state, starts every 0.5 s, from a start on only the
commands are known.

- The peers get uniform samples at 30, 20 or 10 Hz, made from the past only; commands are averages of what was held.
  Each axis is modelled in the heading frame; where yaw has a model, its prediction turns x and y.
- Settings (rate, lags, delays, orders, thresholds, output) are chosen on held-out parts of the training flights by the
  very scores of the table. The search is in `bench/peers/packages.py`, the choices in `bench/peers.json`.
- `PySINDy`: acceleration from velocity and delayed command, linear or with squares, STLSQ; starts from a line over the
  last samples. `SysIdentPy`: FROLS on lags, linear or of degree 2, order by information criterion. `N4SID`: nfoursid
  with its own Kalman filter. `statsmodels`: least squares on lags (ARX). `hold` keeps the velocity; `paper` is the
  paper's regression with a filter of its own, `coast` its coefficients from the states of `ml`; `truth` is the
  simulated vehicle itself, with its own wind levels.
- `ml` is the default ([averaged laws](structures.md#the-default-averaged)), `auto` the structure that the training
  flights earn (`--structure auto`).
- The two signs say how `ml` and `auto` do against the method, by a paired test over starts that respects their overlap,
  at 5 %: `+` rotorfit predicts better, `=` tie, `-` worse, `?` too few starts to say. Of 100 true ties about five come
  out as + or -. The sign beside `auto` is that of `ml` against it.
- `loop` is the t value of the command that follows an output. Beyond 4.5 the commands answer the motion: from them a
  free regression can read what the vehicle has done after the start. That is no prediction, and no controller can use
  it: in the simulated set that is held in place such models beat the true vehicle."""

BEGIN, END = "<!-- peers: begin -->", "<!-- peers: end -->"


def pooled(row: Mapping[str, Any], score: str) -> float | None:
    """RMSE over all test flights; None where one has too few predictions."""
    pairs = [(value, n) for value, n in zip(row[score], row[f"n_{score}"], strict=True)]
    if any(value is None for value, _ in pairs):
        return None
    total = sum(n for _, n in pairs)
    return math.sqrt(sum(n * value**2 for value, n in pairs) / total)


def cell(row: Mapping[str, Any], score: str) -> str:
    """RMSE in cm, cm/s or 0.01 rad, and the verdict on ml against it."""
    value = pooled(row, score)
    if value is None:
        return "n/a"
    text = f"{100 * value:.2f}" if value < RAN_AWAY / 10 else "ran away"
    signs = [SIGNS[verdict(row[key][score])] for key in ("ml_against", "auto_against") if key in row]
    return f"{text} {''.join(signs)}" if signs else text


def verdict(test: Mapping[str, Any] | None) -> str:
    """Of a paired test; too short where there is none."""
    return str(test["verdict"]) if test else "too_short"


def print_case(result: Mapping[str, Any]) -> None:
    print(f"\n{result['set']}    laws of ml and auto: {result['structures']}")
    names = [name for name in NAMES if name in next(iter(result["axes"].values()), NAMES)]
    print(f"{'':18}" + "".join(f"{name:>13}" for name in names))
    for axis, rows in result["axes"].items():
        for score, label in (("velocity_1s", "1 s"), ("position_5s", "5 s")):
            cells = "".join(f"{cell(rows[name], score):>13}" for name in names)
            print(f"{axis:>5} {label:4} n {sum(rows['ml'][f'n_{score}']):<5d}" + cells)
        print(f"      t of the later command {result['loop'][axis]:+.1f}")
        for name, row in rows.items():
            if "setting" in row:
                print(f"      {name}: {row['setting']}")
                for own in ("ml", "auto"):
                    for score, test in row[f"{own}_against"].items():
                        if test and test.get("p") is not None and test["rmse"] > 0:
                            p, freedom = test["p"], test["freedom"]
                            print(f"        {own} is behind at {score}: p {p:.3f}, freedom {freedom:.1f}")


def document(result: Mapping[str, Any], path: Path) -> None:
    """Writes the section between its marks, or at the end of the page; nothing else of the page is touched."""
    text = path.read_text(encoding="utf-8") if path.exists() else "# Benchmarks\n"
    section = f"{BEGIN}\n{section_text(result)}\n{END}"
    if BEGIN in text and END in text:
        text = text[: text.index(BEGIN)] + section + text[text.index(END) + len(END) :]
    else:
        text = f"{text.rstrip()}\n\n{section}\n"
    path.write_text(text, encoding="utf-8")


def section_text(result: Mapping[str, Any]) -> str:
    """The section "Peers" as markdown."""
    return "\n\n".join(
        [
            "## Peers",
            f"Made by `bench/bench_peers.py` on {result['date']}; figures in `bench/peers.json`.\n"
            + ", ".join(f"{name} {number}" for name, number in result["versions"].items())
            + ".",
            EXPLAINED,
            _markdown(result["sets"], "velocity_1s", "RMSE of the velocity over 1 s [cm/s; yaw 0.01 rad/s]"),
            _markdown(result["sets"], "position_5s", "RMSE of the position after 5 s [cm; yaw 0.01 rad]"),
            _counts(result["sets"]),
        ]
    )


def _markdown(sets: Sequence[Mapping[str, Any]], score: str, title: str) -> str:
    head = ["set", "axis", "loop", "n", *NAMES]
    lines = [f"**{title}**", "", "| " + " | ".join(head) + " |", "|---|---|" + "--:|" * (len(head) - 2)]
    for one in sets:
        for axis, rows in one["axes"].items():
            n = sum(rows["ml"][f"n_{score}"])
            cells = [cell(rows[name], score) if name in rows else "" for name in NAMES]
            lines.append("| " + " | ".join([one["set"], axis, f"{one['loop'][axis]:+.1f}", str(n), *cells]) + " |")
    return "\n".join(lines)


def _counts(sets: Sequence[Mapping[str, Any]]) -> str:
    """Verdicts on rotorfit's two rows against each other method, recorded flights only."""
    lines = [
        "Verdicts on recorded flights, both scores together:",
        "",
        "| | against | better | tie | worse | too few |",
    ]
    lines.append("|---|---|--:|--:|--:|--:|")
    for own in ("ml", "auto"):
        for name in NAMES:
            verdicts = [
                verdict(test)
                for one in sets
                if one["kind"] == "recorded"
                for rows in one["axes"].values()
                for test in rows.get(name, {}).get(f"{own}_against", {}).values()
            ]
            if verdicts:
                counts = [str(verdicts.count(word)) for word in SIGNS]
                lines.append(f"| {own} | {name} | " + " | ".join(counts) + " |")
    return "\n".join(lines)
