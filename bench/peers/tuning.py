"""Choice of the settings of a peer: by prediction of held-out parts of the training flights, never of the test."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from peers.series import Series
from rotorfit.core.frames import Array, Indices
from rotorfit.dynamics.protocol import SETTLING, START_EVERY

Setting = Mapping[str, Any]
Forecast = Callable[[Series, Indices, int], Array]
"""Series, start samples (S,), steps T -> y[k + 1 .. k + T] from y up to k and all u, shape (S, T)."""

HELD_OUT = 0.4
"""Share of a single training flight that is held out, once its end and once its beginning."""

LEAST_EXCITED = 0.2
"""A fold is left out if the command varies less in its training than this share of the whole: nothing to learn from."""

FAILED = np.inf

WORTH = 0.2
"""What a later round's richer model must gain over the best of the rounds before it, in the sum of log RMSE (5 % each
of four): products of lags and sparse libraries win by less than that by chance, and run away on the test."""


@dataclass(frozen=True)
class Peer:
    """One way to identify a model.

    Attributes:
        name: As printed.
        package: Of the package index.
        fit: Training series and a setting to a forecast.
        rounds: Each takes the best setting so far, None at first, and gives those to try next.
        rates: Rates of the grid that it may choose from [Hz].
    """

    name: str
    package: str
    fit: Callable[[Sequence[Series], Setting], Forecast]
    rounds: tuple[Callable[[Setting | None], list[Setting]], ...]


@dataclass(frozen=True)
class Fold:
    """Training series, and starts on which to score: a series with its start samples."""

    training: tuple[Series, ...]
    scored: tuple[tuple[Series, Indices], ...]


def chosen(peer: Peer, training: Mapping[int, Sequence[Series]]) -> tuple[Setting, Forecast]:
    """The setting that predicts the held-out parts best, and the model that it gives on all of the training.

    Args:
        peer: Which.
        training: Rate [Hz] to the series of the training flights.

    Raises:
        RuntimeError: No setting gives a model.
    """
    parted = {rate: folds(series) for rate, series in training.items()}
    best: Setting | None = None
    least = FAILED
    for number, settings in enumerate(peer.rounds):
        least = least - WORTH if number else least
        for setting in settings(best):
            if setting["rate"] not in training or setting == best:
                continue
            score = held_out_score(peer, parted[setting["rate"]], setting)
            if score < least:
                best, least = setting, score
    if best is None:
        raise RuntimeError(f"{peer.name}: no setting gives a model that stays finite")
    return best, fitted(peer, training[best["rate"]], best)


def fitted(peer: Peer, series: Sequence[Series], setting: Setting) -> Forecast:
    """The peer's model; its warnings on short or collinear data are expected of a search and not shown."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return peer.fit(series, setting)


def folds(series: Sequence[Series]) -> tuple[Fold, ...]:
    """Two ways to hold out: the last and the first flight, or the end and the beginning of the only one."""
    if len(series) > 1:
        return tuple(
            Fold(tuple(s for s in series if s is not out), ((out, starts_of(out, 0, out.y.size)),))
            for out in (series[-1], series[0])
        )
    only = series[0]
    n = only.y.size
    late, early = round((1 - HELD_OUT) * n), round(HELD_OUT * n)
    both = (
        Fold((Series(only.y[:late], only.u[:late], only.step),), ((only, starts_of(only, late, n)),)),
        Fold((Series(only.y[early:], only.u[early:], only.step),), ((only, starts_of(only, 0, early)),)),
    )
    moved = [fold for fold in both if np.std(fold.training[0].u) > LEAST_EXCITED * np.std(only.u)]
    return tuple(moved) or both


def starts_of(series: Series, low: int, high: int) -> Indices:
    """Starts every 0.5 s within [low, high) from which at least 1 s can be scored, after 2 s of settling."""
    settled, second = round(SETTLING / series.step), round(1 / series.step)
    return np.arange(max(low, settled), high - second, round(START_EVERY / series.step))


def held_out_score(peer: Peer, parts: Sequence[Fold], setting: Setting) -> float:
    """Sum over folds and over 1 s velocity and 5 s position of log RMSE; infinite where the model fails."""
    total = 0.0
    for fold in parts:
        try:
            forecast = fitted(peer, fold.training, setting)
        except (ValueError, IndexError, np.linalg.LinAlgError, ZeroDivisionError):
            return FAILED  # too many regressors for the data, or a subspace of lower rank than asked for
        for series, starts in fold.scored:
            total += _log_errors(forecast, series, starts)
    return total if np.isfinite(total) else FAILED


def _log_errors(forecast: Forecast, series: Series, starts: Indices) -> float:
    total = 0.0
    for seconds, position in ((1.0, False), (5.0, True)):
        steps = round(seconds / series.step)
        useful = starts[starts + steps < series.y.size]
        if useful.size < 3:
            continue  # a bag of 10 s has no 5 s to spare
        with np.errstate(all="ignore"):
            error = forecast(series, useful, steps) - series.y[useful[:, None] + np.arange(1, steps + 1)]
            if position:
                error = error.sum(axis=1) * series.step
            total += float(np.log(np.sqrt(np.mean(error**2))))
    return total
