"""The line below all points with the least mean distance: what a message that came without delay shows of a clock.

Source: S. B. Moon, P. Skelly, D. Towsley, Estimation and removal of clock skew from network delay measurements, INFOCOM
1999, pp. 227-234.
"""

import numpy as np

from rotorfit.core.frames import Array


def line_below(x: Array, y: Array) -> tuple[float, float]:
    """Value at x = 0 and slope of the line that lies below all points with the least mean distance.

    It is the edge of the lower convex hull that spans the mean of x.

    Args:
        x: Increasing, shape (N,).
        y: Shape (N,).
    """
    hull: list[int] = []
    t, late = x.tolist(), y.tolist()  # Python floats: one by one, those of NumPy take ten times as long
    for k in range(len(t)):
        while len(hull) > 1:
            i, j = hull[-2:]
            if (late[j] - late[i]) * (t[k] - t[i]) < (late[k] - late[i]) * (t[j] - t[i]):
                break
            hull.pop()
        hull.append(k)
    right = min(max(1, int(np.searchsorted(x[hull], np.mean(x)))), len(hull) - 1)
    i, j = hull[right - 1], hull[right]
    slope = float((y[j] - y[i]) / (x[j] - x[i]))
    return float(y[i]) - slope * float(x[i]), slope
