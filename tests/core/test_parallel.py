"""Work in threads: the same results in the same order, errors passed on, and no threads where the flights are short."""

import threading

import pytest

from rotorfit.core import parallel


def thread_of(_item: int) -> int:
    return threading.get_ident()


def test_short_flights_take_no_threads_and_begin_only_when_asked() -> None:
    begun: list[int] = []

    def work(item: int) -> int:
        begun.append(item)
        return thread_of(item)

    results = parallel.each(work, range(3), seconds=parallel.LONG / 2)
    assert begun == []
    assert next(results) == threading.get_ident()
    assert begun == [0]
    assert set(results) == {threading.get_ident()}


def test_long_flights_are_worked_on_side_by_side_and_results_keep_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "processors", lambda: 2)
    other = threading.Event()

    def work(item: int) -> int:
        if item == 0:
            assert other.wait(20.0)  # in vain if the second item waited for the first
        else:
            other.set()
        return item**2

    assert list(parallel.each(work, range(4), seconds=parallel.LONG)) == [0, 1, 4, 9]


def test_the_error_of_an_item_reaches_the_caller_and_the_rest_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "processors", lambda: 2)

    def work(item: int) -> int:
        if item == 1:
            raise ValueError("no such flight")
        return item

    results = parallel.each(work, range(3), seconds=parallel.LONG)
    assert next(results) == 0
    with pytest.raises(ValueError, match="no such flight"):
        list(results)
