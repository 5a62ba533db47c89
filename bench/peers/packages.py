"""The peers: each used as its documentation recommends, with the settings that a careful user would try.

What a package does not provide, its user supplies: delays are lags or shifted inputs; an initial state is the last
samples, a Kalman filter, or a one-sided polynomial. Predictions are computed from the coefficients of the package, for
all starts at once, because the packages' own loops over samples take minutes.
"""

import functools
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np

from peers.series import RATES, Series
from peers.tuning import Forecast, Peer, Setting
from rotorfit.core.frames import Array, Indices

INPUT_SPAN = 0.5
"""Longest lag of an input that is tried [s]; delays of multirotors over Wi-Fi are 0.1 to 0.3 s."""


def lag_forecast(rows: Callable[[Array, Array], Array], output_lags: int, input_lags: int) -> Forecast:
    """Free run of y[k + 1] = rows(past y: y[k], y[k - 1] ..; past u: u[k], u[k - 1] ..) from many starts at once."""

    def forecast(series: Series, starts: Indices, steps: int) -> Array:
        y, u = (np.concatenate([np.full(64, v[0]), v]) for v in (series.y, series.u))  # before the first: as the first
        at = starts + 64
        past = y[at[:, None] - np.arange(output_lags)]
        out = np.empty((starts.size, steps))
        for step in range(steps):
            known = np.minimum(at[:, None] + step - np.arange(input_lags), u.size - 1)
            out[:, step] = rows(past, u[known])
            past = np.column_stack([out[:, step], past[:, :-1]])
        return out

    return forecast


def scales(training: Sequence[Series]) -> tuple[float, float]:
    """Standard deviations of output and input: packages that compare terms want them of one size."""
    y, u = (float(np.std(np.concatenate(part))) for part in ([s.y for s in training], [s.u for s in training]))
    return max(y, 1e-9), max(u, 1e-9)


# statsmodels: ordinary least squares on lagged outputs and inputs (ARX)


def statsmodels_fit(training: Sequence[Series], setting: Setting) -> Forecast:
    """OLS of y[k + 1] on `outputs` past outputs, inputs of `delay` .. `delay + inputs` steps before, and a constant."""
    import statsmodels.api as sm

    outputs, delay, inputs = setting["outputs"], setting["delay"], setting["inputs"]
    reach = delay + inputs
    first = max(outputs, reach)

    def regressors(past_y: Array, past_u: Array) -> Array:
        x = np.column_stack([past_y, past_u[:, delay:]])
        return np.column_stack([np.ones(len(x)), x]) if setting["constant"] else x

    rows, values = [], []
    for series in training:
        k = np.arange(first - 1, series.y.size - 1)
        rows.append(regressors(series.y[k[:, None] - np.arange(outputs)], series.u[k[:, None] - np.arange(reach)]))
        values.append(series.y[k + 1])
    theta = sm.OLS(np.concatenate(values), np.concatenate(rows)).fit().params
    return lag_forecast(lambda past_y, past_u: regressors(past_y, past_u) @ theta, outputs, reach)


def statsmodels_orders(_: Setting | None) -> list[Setting]:
    """Full blocks of lags, and the single delayed input of a first-order model."""
    out: list[Setting] = []
    for rate, outputs, constant in product(RATES, (1, 2, 4, 8), (False, True)):
        spans = {(0, round(span * rate)) for span in (0.2, 0.35, INPUT_SPAN)}
        single = {(round(delay * rate), 1) for delay in (0.0, 0.1, 0.15, 0.2, 0.25, 0.3)}
        for delay, inputs in sorted(spans | single):
            out.append({"rate": rate, "outputs": outputs, "delay": delay, "inputs": inputs, "constant": constant})
    return out


# SysIdentPy: NARX by forward regression with orthogonal least squares (FROLS), order by an information criterion


def sysidentpy_fit(training: Sequence[Series], setting: Setting) -> Forecast:
    """FROLS on polynomials of lags; several flights follow one another, which spoils one lag's length at each seam."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    scale_y, scale_u = scales(training)
    y = np.concatenate([s.y for s in training])[:, None] / scale_y
    x = np.concatenate([s.u for s in training])[:, None] / scale_u
    model = FROLS(
        order_selection=True,
        n_info_values=setting["terms"],
        ylag=setting["outputs"],
        xlag=setting["inputs"],
        info_criteria=setting["criterion"],
        estimator=LeastSquares(),
        basis_function=Polynomial(degree=setting["degree"]),
    )
    model.fit(X=x, y=y)
    codes, theta = np.asarray(model.final_model), np.asarray(model.theta).ravel()

    def rows(past_y: Array, past_u: Array) -> Array:
        # A code is 1000 * variable + lag (1 output, 2 input); 0 is the constant. Lag 1 is y[k] and u[k].
        total = np.zeros(len(past_y))
        for code, coefficient in zip(codes, theta, strict=True):
            term = np.full(len(past_y), coefficient)
            for number in code[code > 0]:
                values, scale = (past_y, scale_y) if number // 1000 == 1 else (past_u, scale_u)
                term = term * values[:, number % 1000 - 1] / scale
            total += term
        return total * scale_y

    return lag_forecast(rows, setting["outputs"], setting["inputs"])


def sysidentpy_orders(_: Setting | None) -> list[Setting]:
    """Linear first: lags of the output, span of the input, and the criterion."""
    return [
        {
            "rate": rate, "outputs": outputs, "inputs": max(2, round(span * rate)), "degree": 1, "criterion": criterion,
            "terms": 15,
        }
        for rate, outputs, span, criterion in product(RATES, (2, 3, 6), (0.35, INPUT_SPAN), ("aic", "bic"))
    ]  # fmt: skip


def sysidentpy_degree(best: Setting | None) -> list[Setting]:
    """Then products of two lags, with as many terms as before and fewer."""
    if best is None:
        return []
    return [{**best, "degree": 2, "terms": terms, "outputs": min(best["outputs"], 3)} for terms in (6, 15)]


# nfoursid: N4SID with its Kalman filter


def nfoursid_fit(training: Sequence[Series], setting: Setting) -> Forecast:
    """State space by N4SID; the state at a start is its Kalman filter's, with the covariances that it estimates."""
    from nfoursid.kalman import Kalman

    integrated = setting["output"] == "position"
    scale_y, scale_u = scales(training)
    space, covariance = subspace(tuple(training), integrated, setting["rows"]).system_identification(setting["order"])
    filtered = Kalman(space, covariance)
    for _ in range(200):  # until its gain stands still; the gain does not depend on the data
        filtered.step(np.zeros((1, 1)), np.zeros((1, 1)))
    A, B, C, D, K = space.a, space.b[:, 0], space.c[0], space.d[0, 0], filtered.kalman_gains[-1][:, 0]
    if not np.isfinite(K).all():
        raise ValueError("the Kalman filter of this model has no steady gain")

    def forecast(series: Series, starts: Indices, steps: int) -> Array:
        measured, u = integral(series, integrated) / scale_y, series.u / scale_u
        states = np.zeros((measured.size + 1, A.shape[0]))
        states[0] = np.linalg.pinv(C[None])[:, 0] * measured[0]
        for k in range(int(starts.max()) + 1):
            states[k + 1] = A @ states[k] + B * u[k] + K * (measured[k] - C @ states[k] - D * u[k])
        state, out = states[starts + 1], np.empty((starts.size, steps))
        for step in range(steps):
            known = u[np.minimum(starts + 1 + step, u.size - 1)]
            out[:, step] = state @ C + D * known
            state = state @ A.T + known[:, None] * B
        if integrated:
            begin = states[starts] @ C + D * u[starts]
            out = np.diff(np.column_stack([begin, out]), axis=1) / series.step
        return out * scale_y

    return forecast


def integral(series: Series, integrated: bool) -> Array:
    """The output, or the position that it adds up to."""
    return np.cumsum(series.y) * series.step if integrated else series.y


@functools.lru_cache(maxsize=4)
def subspace(training: tuple[Series, ...], integrated: bool, rows: int) -> Any:
    """The part of N4SID that does not know the order yet, so that all orders share it."""
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    scale_y, scale_u = scales(training)
    y, seam = [], 0.0
    for series in training:  # positions are carried on from flight to flight, so that no seam jumps
        y.append(integral(series, integrated) / scale_y + seam)
        seam = float(y[-1][-1]) if integrated else 0.0
    # nfoursid lets u[k] act on y[k] and y[k + 1]; that u[k] acts on y[k + 1] first is for it to find.
    table = pd.DataFrame({"u": np.concatenate([s.u for s in training]) / scale_u, "y": np.concatenate(y)})
    method = NFourSID(table, output_columns=["y"], input_columns=["u"], num_block_rows=rows)
    method.subspace_identification()
    return method


def nfoursid_orders(_: Setting | None) -> list[Setting]:
    """Order 1 to 6, block rows of 0.5 and 1 s, velocity or position as output."""
    out: list[Setting] = []
    for rate, output, span in product(RATES[1:], ("velocity", "position"), (0.5, 1.0)):
        rows = max(4, round(span * rate))
        orders = range(1, min(7, rows))
        out += [{"rate": rate, "output": output, "rows": rows, "order": order} for order in orders]
    return out


# PySINDy: acceleration as a sparse function of velocity and delayed command


def pysindy_fit(training: Sequence[Series], setting: Setting) -> Forecast:
    """SINDy with control: v' = f(v, u(t - delay)); position smoothed and differentiated by the package."""
    import pysindy as ps

    step = training[0].step
    delays = [round(delay / step) for delay in setting["delays"]]
    scale_y, scale_u = scales(training)  # so that one threshold suits all terms
    window = max(5, 2 * round(setting["window"] / step / 2) + 1)

    def inputs(series: Series, later: int = 0) -> Array:
        u = series.u / scale_u
        shifts = [delay + later for delay in delays]
        return np.column_stack([np.concatenate([np.full(d, u[0]), u[: u.size - d]]) for d in shifts])

    # y[k] is the velocity at the middle of the step before its sample; the command of that step is u[k - 1].
    smooth = {"window_length": window, "polyorder": 3}
    model = ps.SINDy(
        optimizer=ps.STLSQ(threshold=setting["threshold"], alpha=1e-9),
        differentiation_method=ps.SmoothedFiniteDifference(smoother_kws=smooth),
        feature_library=ps.PolynomialLibrary(degree=setting["degree"]),
    )
    model.fit([s.y[:, None] / scale_y for s in training], t=step, u=[inputs(s, 1) for s in training])
    coefficients, powers = np.asarray(model.coefficients())[0], np.asarray(model.feature_library.powers_)
    past = max(2, round(setting["past"] / step))

    def slope(v: Array, u: Array) -> Array:
        slopes: Array = np.prod(np.column_stack([v, u])[:, None] ** powers, axis=-1) @ coefficients
        return slopes

    # A line over the last samples, at the start, which is half a step after the last of them.
    lever = np.arange(past) - (past - 1) / 2
    weights = 1 / past + ((past - 1) / 2 + 0.5) * lever / (lever @ lever)

    def forecast(series: Series, starts: Indices, steps: int) -> Array:
        u = inputs(series)
        y = np.concatenate([np.full(past, series.y[0]), series.y]) / scale_y
        v = y[starts[:, None] + past + np.arange(1 - past, 1)] @ weights
        out = np.empty((starts.size, steps))
        for k in range(steps):
            held = u[np.minimum(starts + k, len(u) - 1)]
            first = slope(v, held)
            second = slope(v + step * first / 2, held)  # midpoint rule: the command is constant over a step
            out[:, k] = v + step * second / 2
            v = v + step * second
        return out * scale_y

    return forecast


def pysindy_delays(_: Setting | None) -> list[Setting]:
    """Linear first: the delay, the smoothing window, the span of the velocity at the start."""
    return [
        {"rate": rate, "delays": (delay,), "window": window, "past": past, "degree": 1, "threshold": 0.0}
        for rate, delay, window, past in product(RATES, (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3), (0.3, 0.6), (0.1, 0.25))
        if rate > 10 or delay in (0.0, 0.1, 0.2, 0.3)
    ]


def pysindy_libraries(best: Setting | None) -> list[Setting]:
    """Then squares, several delays at once, and thresholds that leave fewer terms."""
    if best is None:
        return []
    libraries: list[dict[str, Any]] = [{}, {"degree": 2}, {"delays": (0.0, 0.1, 0.2, 0.3)}]
    return [
        {**best, **library, "threshold": threshold} for library, threshold in product(libraries, (0.0, 0.03, 0.1, 0.3))
    ]


PEERS = (
    Peer("PySINDy", "pysindy", pysindy_fit, (pysindy_delays, pysindy_libraries)),
    Peer("SysIdentPy", "sysidentpy", sysidentpy_fit, (sysidentpy_orders, sysidentpy_degree)),
    Peer("N4SID", "nfoursid", nfoursid_fit, (nfoursid_orders,)),
    Peer("statsmodels", "statsmodels", statsmodels_fit, (statsmodels_orders,)),
)
