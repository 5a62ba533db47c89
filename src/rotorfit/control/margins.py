"""Stability margins of the sampled loop, exactly: how far a vehicle may differ from what its control law assumes.

A pose is measured every period h; the command computed from it is held for h and acts after the delay. During a period
two commands move the vehicle: the old one for the rest of the delay, then the next. From pose to pose the loop is
therefore a linear system of finite order, whatever the delay. With P(z) from the command to the measured pose, C(z) the
law, and L = -C P,

    stable       every eigenvalue of the closed loop is inside the unit circle
    gain margin  the factors on the vehicle's gain between which it is stable, from the crossings of the negative axis
    phase margin the least distance of L from -1 in angle where |L| = 1
    peak         of the sensitivity 1 / |1 + L|: 1 over the least distance of L from -1
    delay margin the additional delay at which it becomes unstable

Source: K. J. Åström, B. Wittenmark, Computer-Controlled Systems, 3rd ed. (1997): sampling with a delay;
K. J. Åström, R. M. Murray, Feedback Systems: stability margins.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from rotorfit.control.control_law import AxisLaw, linear_system, whole_periods
from rotorfit.control.loop_vehicle import LoopVehicle, vehicle_step
from rotorfit.core.frames import Array

SLOWEST, DENSITY = 0.01, 200
"""Lowest frequency of the grid [rad/s], a tenth of the slowest bandwidth that is tuned for, and its number of points in
a decade; crossings are refined by root finding."""

STEP = 0.005
"""Least step of the search for the delay margin [s]: commands that come faster do not make it finer."""

LONGEST = 2.0
"""Largest delay margin that is searched for [s]: the loop has a state for each command under way. Of longer ones, the
parts of a period by which phase over frequency misses are less than a hundredth."""


@dataclass(frozen=True)
class Margins:
    """Margins of one axis.

    Attributes:
        stable: Whether the closed loop is stable.
        gain: Factors on the vehicle's gain, the largest below and the smallest above 1, at which the loop becomes
            unstable; 0 or infinite if there is none.
        phase: Phase margin [rad].
        delay: Delay margin [s].
        peak: Peak of the sensitivity.
        crossover: Highest frequency at which |L| = 1 [rad/s]; 0 if there is none.
    """

    stable: bool
    gain: tuple[float, float]
    phase: float
    delay: float
    peak: float
    crossover: float


def closed_loop(law: AxisLaw, vehicle: LoopVehicle) -> Array:
    """Transition matrix of the loop from pose to pose, for a vehicle other than the law may assume, shape (n, n).

    States: the vehicle's position, velocity and, with a lag, third state; then those of the law.
    """
    reach = vehicle.delay + law.latency
    whole, _ = whole_periods(reach, law.period)
    A, B, _ = linear_system(law, whole + 2)
    step, late, new = vehicle_step(vehicle, reach, law.period)
    m, n = len(step), len(A)
    M = np.zeros((m + n, m + n))
    M[:m, :m] = step
    M[:m, m + 3 + whole] += new
    M[:m, m + 4 + whole] += late
    M[m:, m:] = A
    M[m:] += np.outer(B, M[0])
    return M


def spectral_radius(law: AxisLaw, vehicle: LoopVehicle) -> float:
    """Largest modulus of the eigenvalues of the closed loop; below 1 it is stable."""
    return float(np.abs(np.linalg.eigvals(closed_loop(law, vehicle))).max())


def law_response(law: AxisLaw, w: Array) -> Array:
    """C(e^(i w h)), from the measured pose to the command, complex, shape of w [rad/s].

    The commands under way are the latest one, each a period earlier: four states are left to be solved for.
    """
    A, B, _ = linear_system(law)
    z = np.exp(1j * w * law.period)[..., None]
    reduced = np.empty((*w.shape, 4, 4), complex)
    reduced[..., :3] = A[:4, :3]
    reduced[..., 3] = z ** -np.arange(len(A) - 3.0) @ A[:4, 3:].T
    return np.asarray(z[..., 0] * np.linalg.solve(z[..., None] * np.eye(4) - reduced, B[:4, None])[..., 3, 0])


def vehicle_response(vehicle: LoopVehicle, period: float, latency: float, w: Array) -> Array:
    """P(e^(i w h)), from the command to the measured pose, complex, shape of w [rad/s]."""
    reach = vehicle.delay + latency
    whole, _ = whole_periods(reach, period)
    step, late, new = vehicle_step(vehicle, reach, period)
    z = np.exp(1j * w * period)[..., None]
    effect = new * z ** float(-whole) + late * z ** float(-whole - 1)
    if len(step) == 2:
        rest = effect[..., 1:] / (z - step[1, 1])
    else:
        rest = np.linalg.solve(z[..., None] * np.eye(len(step) - 1) - step[1:, 1:], effect[..., 1:, None])[..., 0]
    return np.asarray((effect[..., 0] + rest @ step[0, 1:]) / (z[..., 0] - 1.0))


def open_loop(law: AxisLaw, vehicle: LoopVehicle) -> Callable[[Array], Array]:
    """L as a function of the frequency [rad/s]."""
    return lambda w: -law_response(law, w) * vehicle_response(vehicle, law.period, law.latency, w)


def frequencies(period: float, density: int = DENSITY) -> Array:
    """A grid from `SLOWEST` up to the Nyquist frequency, shape (F,) [rad/s], with so many points in a decade."""
    nyquist = np.pi / period
    return np.geomspace(SLOWEST, nyquist * (1.0 - 1e-9), round(density * np.log10(nyquist / SLOWEST)))


def margins(law: AxisLaw, vehicle: LoopVehicle) -> Margins:
    """Margins of a law around a vehicle; none of them is left if the loop is unstable."""
    L = open_loop(law, vehicle)
    w = frequencies(law.period)
    values = L(w)
    unit = np.array(_roots(lambda x: float(np.log(np.abs(L(np.array(x))))), w, np.log(np.abs(values))))
    real = _roots(lambda x: float(L(np.array(x)).imag), w, values.imag)
    real = [*real, np.pi / law.period]  # at the Nyquist frequency the loop is real
    crossings = np.array([-L(np.array(x)).real for x in real] + [0.0, np.inf])
    factors = 1 / crossings[crossings > 0]
    if spectral_radius(law, vehicle) >= 1:
        return Margins(False, (1.0, 1.0), 0.0, 0.0, np.inf, float(unit.max(initial=0.0)))
    angle = np.angle(-L(unit))
    below, above = factors[factors < 1], factors[factors > 1]
    return Margins(
        True,
        (float(below.max(initial=0.0)), float(above.min(initial=np.inf))),
        float(np.abs(angle).min(initial=np.pi)),
        delay_margin(law, vehicle, float((np.mod(angle, 2 * np.pi) / unit).min(initial=np.inf))),
        _peak(L, w, values),
        float(unit.max(initial=0.0)),
    )


def delay_margin(law: AxisLaw, vehicle: LoopVehicle, about: float) -> float:
    """The least additional delay that makes a stable loop unstable [s]; infinite if |L| is nowhere 1.

    The eigenvalues are evaluated every quarter of a period, or `STEP`, and the crossing is refined by root finding.
    Beyond `LONGEST` it is `about`.

    Args:
        law: The law.
        vehicle: A vehicle with which the loop is stable.
        about: The least phase over the frequency where |L| = 1 [s]: the delay margin, but that parts of a period change
            |L| a little. The search begins a little before, where the loop is stable there, else at no delay.
    """

    def excess(more: float) -> float:
        return spectral_radius(law, vehicle._replace(delay=vehicle.delay + more)) - 1.0

    begin = about - 3 * max(law.period, STEP)
    if begin >= LONGEST:
        return about
    begin = begin if begin > 0 and excess(begin) < 0 else 0.0
    for low, high in pairwise(np.arange(begin, LONGEST, max(law.period / 4, STEP)).tolist()):
        if excess(high) >= 0:
            return float(brentq(excess, low, high, xtol=1e-7))
    return about


def _roots(f: Callable[[float], float], w: Array, values: Array) -> list[float]:
    """Roots of a function between neighbours of the grid at which its sign changes."""
    places = np.flatnonzero(values[:-1] * values[1:] < 0)
    return [float(brentq(f, w[i], w[i + 1], xtol=1e-9)) for i in places]


def _peak(L: Callable[[Array], Array], w: Array, values: Array) -> float:
    """Peak of the sensitivity, refined between the neighbours of its highest value on the grid."""
    top = int(np.argmin(np.abs(1 + values)))
    ends = (w[max(top - 1, 0)], w[min(top + 1, w.size - 1)])
    found = minimize_scalar(lambda x: float(np.abs(1 + L(np.array(x)))), bounds=ends, method="bounded")
    return float(1 / min(found.fun, np.abs(1 + values[top])))
