"""Delay, lag or both? Each half of a flight is fitted with each law and predicts the other half; then `auto` selects.

    python bench/bench_structures.py FOLDER_OF_bebop2-wsu

The flights are public: GitHub mhsnar/Closed-loop-Identification. Prints Markdown.
"""

import sys
import time
from pathlib import Path

from rotorfit.app.workflows import load_flight
from rotorfit.assessment.validation import validate
from rotorfit.core.model import Combination, Model
from rotorfit.estimation.fitting import fit
from rotorfit.files.log_span import LogSpan

DEFAULT = Path(__file__).resolve().parents[2] / "shared/data/bebop2-wsu"
FLIGHTS = (("X", "x"), ("Z", "z"))
STRUCTURES = ("first_order", "first_order_delay", "first_order_lag", "first_order_delay_lag")


def log_likelihood(fitted: object, axis: str) -> float:
    return fitted.estimates[axis].optimum.score.log_likelihood  # type: ignore[attr-defined, no-any-return]


def interval(part: Combination | None) -> str:
    if part is None:
        return ""
    low, high = ("open" if end is None else f"{end:.3f}" for end in part.ci95)
    return f"{part.value:.3f} ({low} to {high})"


def late(model: Model, axis: str) -> str:
    """Delay plus lag."""
    known = model.axes[axis]
    if known.predictor is None:
        return known.status["input"]
    if "delay_plus_lag" in known.combinations:
        return interval(known.combinations["delay_plus_lag"])
    return interval(Combination(known.predictor.delay, known.ci95["delay"]))


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT
    if not folder.is_dir():
        print(f"skipped: {folder} is not there; give the folder of bebop2-wsu")
        return
    card = str(folder / "card.toml")
    print("| flight | fitted half | structure | log L | 1 s [cm/s] | 5 s [cm] | delay + lag [s] |")
    print("|---|---|---|---|---|---|---|")
    for name, axis in FLIGHTS:
        path = str(folder / f"Training_CT_TestDay_{name}.mat")
        middle = round(load_flight(LogSpan(path, (None, None)), card).duration / 2)
        spans = ((None, float(middle)), (float(middle), None))
        halves = [load_flight(LogSpan(path, span), card) for span in spans]
        for number, word in enumerate(("first", "second")):
            best: float | None = None
            for structure in STRUCTURES:
                fitted = fit([halves[number]], axes=(axis,), structure=structure)
                found = log_likelihood(fitted, axis)
                best = found if structure == "first_order_delay" else best
                score = validate(fitted.model, [halves[1 - number]], (1.0, 5.0)).flights[0].axes[axis].horizons
                errors = [score["1"].velocity_rmse, score["5"].position_rmse]
                cells = ["-" if e is None else f"{100 * e:.2f}" for e in errors]
                told = late(fitted.model, axis)
                print(
                    f"| {name} | {word} | `{structure}` | {found:.1f} | {cells[0]} | {cells[1]} | {told} |", flush=True
                )
        for word, flight in (("first half", halves[0]), ("second half", halves[1]), ("whole", None)):
            whole = flight or load_flight(LogSpan(path, (None, None)), card)
            start = time.perf_counter()
            known = fit([whole], axes=(axis,), structure="auto").model.axes[axis]
            print(f"\nauto on the {word} of {name}: {known.structure}, {time.perf_counter() - start:.1f} s\n")
            for one in known.candidates:
                print(f"- `{one.structure}` {one.log_likelihood:+.1f} {one.bic:+.1f}: {one.verdict}")
        print()


if __name__ == "__main__":
    main()
