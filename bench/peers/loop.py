"""Do the recorded commands respond to the vehicle? Then a flexible regression infers the future from them."""

from collections.abc import Sequence

import numpy as np

from peers.series import Series
from rotorfit.core.frames import Array

MEMORY = 8
"""Past outputs and inputs that are taken off first."""


def later_command(series: Sequence[Series]) -> float:
    """How strongly the output of a step goes with the command of the step after it: t of its coefficient.

    y[k + 1] is regressed on past outputs, past inputs, u[k], and u[k + 1], which is given only after y[k + 1] has
    happened. No vehicle answers it; a controller that has seen the motion gives it. Beyond +-4.5 the flight is flown in
    a loop, and predictions "from the commands alone" can read from the later commands what the vehicle has done: a
    model that is free to use them beats the true vehicle (see the simulated set that is held in place).

    The standard error is that of Newey and West.
    """
    import statsmodels.api as sm

    rows: list[Array] = []
    values: list[Array] = []
    for one in series:
        k = np.arange(MEMORY, one.y.size - 1)
        past = k[:, None] - np.arange(MEMORY)
        rows.append(np.column_stack([one.u[k + 1], np.ones(k.size), one.y[past], one.u[past]]))
        values.append(one.y[k + 1])
    fitted = sm.OLS(np.concatenate(values), np.concatenate(rows)).fit(cov_type="HAC", cov_kwds={"maxlags": MEMORY})
    return float(fitted.tvalues[0])
