"""Laws that shape commands have a kernel of their own: it gives what the general law gives."""

from dataclasses import replace

import numpy as np
import pytest

from flights import flown, steps
from rotorfit.core.laws import STRUCTURES, TRIM, start_levels
from rotorfit.estimation.likelihood import block_response
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.simulation.paper_vehicle import Truth

SHAPED = {"saturation": 0.15, "dead_zone": 0.05, "climb_descent": 0.2}
"""The law's name, and a value of its shape that matters to commands of up to 0.3."""


@pytest.mark.parametrize(
    ("axes", "names"),
    [
        (("z",), ("saturation",)),
        (("z",), ("dead_zone",)),
        (("z",), ("climb_descent",)),
        (("x", "y"), ("saturation", "first_order_delay")),
        (("x", "y"), ("first_order_delay", "dead_zone")),
        (("x", "y"), ("dead_zone", "saturation")),
    ],
)
def test_a_law_that_shapes_commands_responds_as_the_general_law(axes: tuple[str, ...], names: tuple[str, ...]) -> None:
    rec = record(flown(Truth(), steps(), 12.0), axes)
    assert rec is not None
    structures = tuple(STRUCTURES[name] for name in names)
    extra = np.zeros((1, len(axes)))
    for k, structure in enumerate(structures):
        for one in structure.extras:
            extra[0, k] = one.coordinate(SHAPED[structure.name])
    start = start_point([rec], 0.12, 0.7, np.tile(start_levels("position"), (len(axes), 1)))
    point = replace(start, trim=start.trim + 0.1, structures=structures, extra=extra)
    laws = point.laws
    laws[:, TRIM] = point.trim[0]

    own = block_response.response(rec, point, 0, point.start)
    general = block_response._general_response(rec, point, laws, point.start)
    for found, expected in zip(own, general, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert (np.abs(own[1][:, 3 * len(axes) : 4 * len(axes)]).max() > 0.01).all()


def test_a_start_velocity_that_has_decayed_to_nothing_has_moved_the_vehicle_by_its_share() -> None:
    rec = record(flown(Truth(), steps(("z",)), 40.0), ("z",))  # 30 /s for 40 s: beyond the smallest numbers
    assert rec is not None
    start = start_point([rec], 0.1, 30.0, start_levels("position")[None])
    point = replace(start, start=start.start + 1.0)
    columns = block_response.response(rec, point, 0, point.start)[1]

    end = columns[-1, -1, 0]
    assert end == pytest.approx(1 / 30.0, rel=1e-9)
    np.testing.assert_allclose(columns[rec.block_time > rec.starts[0] + 2.0, -1, 0], end, rtol=1e-12)
