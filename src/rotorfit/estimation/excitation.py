"""Which axes of a flight count in scores: those that it excites, be it by small commands."""

from collections.abc import Collection, Sequence

from rotorfit.core.flight_data import Flight
from rotorfit.estimation.fitting import estimate_group
from rotorfit.estimation.grouping import groups_of, small_commands, without
from rotorfit.estimation.likelihood.axis_estimate import explains_plainly


def without_idle_axes(flights: Sequence[Flight], beside: Sequence[Flight] = ()) -> list[Flight]:
    """The flights, each without the axes that it only holds while another flight excites them; with a note.

    Commands that are small beside another flight's may excite an axis all the same: a model that is right for small
    commands alone would be judged by the large ones. So an axis stays where the flight by itself plainly shows what its
    commands do. No model that is scored has a say in it.

    Args:
        flights: Flights of one vehicle.
        beside: Further flights of the vehicle, used only to see how strongly an axis is commanded when it is excited.
    """
    out = []
    for flight, shares in zip(flights, small_commands(flights, beside), strict=True):
        excited = _excited(flight, shares) if shares else ()
        held = {axis: share for axis, share in shares.items() if axis not in excited}
        out.append(without(flight, held, "is not scored") if held else flight)
    return out


def _excited(flight: Flight, axes: Collection[str]) -> set[str]:
    """Those of some axes of whose motion the flight's own commands plainly explain a part."""
    return {
        axis
        for group in groups_of([flight], [*axes])
        for axis, one in estimate_group([flight], group, {}).items()
        if axis in axes and one.excited and explains_plainly([flight], one)
    }
