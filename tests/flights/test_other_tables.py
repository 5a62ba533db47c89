"""Which columns stand in another table than the clock of their stream."""

import pytest

from rotorfit.core.card import Channel
from rotorfit.flights.other_tables import is_beside


@pytest.mark.parametrize(
    ("time", "source", "beside"),
    [
        ("t", "x", False),
        ("log:t", "log:x", False),
        ("log:t", "x", False),
        ("t", "log:x", False),  # a clock without a table: the log has only one
        ("log:t", "other:x", True),
    ],
)
def test_a_column_is_beside_where_it_names_another_table(time: str, source: str, beside: bool) -> None:
    assert is_beside(Channel(time), Channel(source)) is beside
