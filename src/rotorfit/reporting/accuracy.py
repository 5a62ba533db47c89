"""The accuracy of a model, as rows of text."""

from collections.abc import Iterator, Mapping

from rotorfit.core.accuracy import COEFFICIENT_ERROR_LIMIT, CORRELATION_LIMIT, INSENSITIVITY_LIMIT, Uncertainty
from rotorfit.core.model import COEFFICIENTS, Axis

PERCENT_HEADS = ("axis", "coefficient", "estimate", "error %", "insens. %", "corr. input", "damping", "delay")

ERROR_HEADS = ("axis", "standard error", "expected", "observed", "sandwich", "bootstrap", "flights")


def percent_rows(table: Uncertainty, axes: Mapping[str, Axis]) -> Iterator[tuple[str, ...]]:
    """Cells under `PERCENT_HEADS`; values beyond their limit are marked, estimates that are not published bracketed."""
    for axis, one in table.axes.items():
        for i, (name, known) in enumerate(one.coefficients.items()):
            yield (
                axis if i == 0 else "",
                name,
                f"{known.value:.4g} " if axes[axis].status[name] == "ok" else f"({known.value:.4g})",
                _percent(known.percent, COEFFICIENT_ERROR_LIMIT),
                _percent(known.insensitivity, INSENSITIVITY_LIMIT),
                *(
                    "" if j > i else f"{value:+.2f}{'!' if j < i and abs(value) > CORRELATION_LIMIT else ' '}"
                    for j, value in enumerate(one.correlation[i][: len(COEFFICIENTS)])
                ),
            )


def error_rows(table: Uncertainty) -> Iterator[tuple[str, ...]]:
    """Cells under `ERROR_HEADS`; ragged values are marked."""
    for axis, one in table.axes.items():
        for i, (name, known) in enumerate(one.coefficients.items()):
            observed = "-" if known.observed is None else f"{known.observed:.2g}"
            yield (
                axis if i == 0 else "",
                name,
                f"{known.expected:.2g}",
                f"{observed}{'~' if known.ragged and known.observed is not None else ' '}",
                f"{known.sandwich:.2g}",
                *("-" if value is None else f"{value:.2g}" for value in (known.bootstrap, known.scatter)),
            )


def accuracy_lines(table: Uncertainty, axes: Mapping[str, Axis]) -> Iterator[str]:
    """What the table is of, how it was made, what cannot be separated, and how well the flights agree."""
    weighed = {axis: axes[axis].laws[0].weight for axis in table.axes if axes[axis].laws}
    laws = (
        f"{axis} {axes[axis].structure}" + (f" (weight {100 * weighed[axis]:.0f} %)" if axis in weighed else "")
        for axis in table.axes
    )
    yield (
        f"all of it is of the flights of this fit and of one law, {', '.join(laws)}: go by the vehicle's intervals, "
        f"which also hold flights to come{' and the other laws' if weighed else ''}; (estimate): see its status"
    )
    yield (
        f"error %: expected (Cramer-Rao); ! beyond {COEFFICIENT_ERROR_LIMIT:g}, insensitivity beyond "
        f"{INSENSITIVITY_LIMIT:g}, correlation beyond {CORRELATION_LIMIT:g}"
    )
    yield (
        f"observed: differences of the score over {table.observed_step:g} standard error; ~ depends on that step, or "
        "on a coefficient at a bound: do not rely on it"
    )
    yield f"sandwich: scores correlated up to {table.sandwich_lag:g} s"
    yield (
        f"bootstrap: {table.bootstrap_flights} flights drawn in blocks of {table.bootstrap_block:g} s, seed "
        f"{table.bootstrap_seed}; commands as recorded, also where a feedback loop gave them"
    )
    for axis, one in table.axes.items():
        for pair in one.inseparable:
            known = ""
            if pair.combination and pair.ci95:
                low, high = pair.ci95
                known = (
                    f"; their {pair.combination.replace('_', ' ')} is known: {pair.value:.4g} ({low:.4g} to {high:.4g})"
                )
            yield f"{axis}: {' and '.join(pair.pair)} move together (correlation {pair.correlation:+.2f}){known}"
        bounded = [name for name, known in one.coefficients.items() if known.bootstrap is None]
        if bounded:
            yield (
                f"{axis}: the search for {' and '.join(bounded)} ended at a bound, or did on more than a few of the "
                "flights drawn: no standard error describes that, see the interval"
            )
        for name, known_one in one.coefficients.items():
            if known_one.disturbance is not None and known_one.disturbance > CORRELATION_LIMIT:
                yield f"{axis}: {name} and the disturbance move together (correlation {known_one.disturbance:.2f})"
        if one.scatter:
            q = ", ".join(f"{name.replace('_', ' ')} {value:.1f}" for name, value in one.scatter.cochran.items())
            i2 = ", ".join(f"{100 * value:.0f} %" for value in one.scatter.i_squared.values())
            yield (
                f"{axis}: {len(one.scatter.flights)} flights, Cochran's Q {q} (I^2 {i2}); together chi-square "
                f"{one.scatter.ratio:.1f} of {one.scatter.freedom}, p = {one.scatter.p_value:.2g}"
            )


def _percent(value: float | None, limit: float) -> str:
    return "-" if value is None else f"{value:.3g}{'!' if value > limit else ' '}"
