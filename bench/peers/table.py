"""The table of the benchmark, for the terminal and for the documentation."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from peers.paired import RAN_AWAY

NAMES = ("hold", "paper", "PySINDy", "SysIdentPy", "N4SID", "statsmodels", "ml", "truth")
SIGNS = {"better": "+", "tie": "=", "worse": "-", "short": "?"}
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
    return f"{text} {SIGNS[row['ml_against'][score]['verdict']]}" if "ml_against" in row else text


def print_case(result: Mapping[str, Any]) -> None:
    print(f"\n{result['set']}    [search: {result['seconds']} s]")
    names = [name for name in NAMES if name in next(iter(result["axes"].values()), NAMES)]
    print(f"{'':18}" + "".join(f"{name:>13}" for name in names))
    for axis, rows in result["axes"].items():
        for score, label in (("velocity_1s", "1 s"), ("position_5s", "5 s")):
            cells = "".join(f"{cell(rows[name], score):>13}" for name in names)
            print(f"{axis:>5} {label:4} n {sum(rows['ml'][f'n_{score}']):<5d}" + cells)
        for name, row in rows.items():
            if "setting" in row:
                print(f"      {name}: {row['setting']}")
                for score, test in row["ml_against"].items():
                    if test["p"] is not None and test["difference"] > 0:
                        print(f"        ml is behind at {score}: p {test['p']:.3f}, freedom {test['freedom']}")


def document(result: Mapping[str, Any], path: Path) -> None:
    raise NotImplementedError
