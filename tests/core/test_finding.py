from dataclasses import replace

from rotorfit.core.finding import Finding, told_together
from rotorfit.core.plain import by_reason, listed


def still(axis: str | None, evidence: str = "the {} command explains nothing") -> Finding:
    return Finding(
        "not_excited", "warning", evidence.format(axis), f"no coefficient of {axis} is a number", "move it", axis
    )


def test_what_holds_of_several_axes_is_told_once() -> None:
    alone, whole = replace(still("yaw"), remedy="command it"), still(None, "the poses repeat")

    told = told_together([still("y"), whole, still("z"), alone])

    assert told[1:] == (whole, alone)
    assert told[0].evidence == "the y and z command explains nothing"
    assert told[0].effect == "no coefficient of y and z is a number"
    assert told[0].axis is None


def test_evidence_that_differs_is_told_of_each_axis_under_one_effect() -> None:
    (told,) = told_together([still("x", "0.3 of {}"), still("y", "0.4 of {}"), still("z", "0.3 of {}")])

    assert told.evidence == "0.3 of x and z;\n0.4 of y"
    assert told.effect == "no coefficient of x, y and z is a number"


def test_the_log_of_findings_that_share_it_is_named_once() -> None:
    (told,) = told_together([still("x", "a.csv: 0.3 of {}"), still("y", "a.csv: 0.4 of {}")])

    assert told.evidence == "a.csv: 0.3 of x;\n0.4 of y"


def test_an_axis_that_several_flights_tell_of_is_named_once() -> None:
    first, second = still("x", "a.csv: 0.3 of {}"), still("x", "b.csv: 0.4 of {}")

    (told,) = told_together([first, still("y", "a.csv: 1 of {}"), second])
    assert told.effect == "no coefficient of x and y is a number"
    (told,) = told_together([first, second])
    assert told.evidence == "a.csv: 0.3 of x;\nb.csv: 0.4 of x"
    assert told.axis == "x"


def test_findings_that_differ_in_more_than_the_axis_stay_apart() -> None:
    both = still("x"), replace(still("y"), remedy="another")

    assert told_together(both) == both
    nameless = still("x", "nothing moves"), still("y", "nothing moves"), still(None, "nothing moves")
    assert told_together(nameless) == nameless


def test_a_reason_is_told_once_for_all_that_it_holds_for() -> None:
    assert (
        by_reason({"x": "no command", "y": "too short", "yaw": "no command"}) == "x and yaw: no command; y: too short"
    )
    assert listed(["x"]) == "x"
    assert listed(["x", "y", "z"], "or") == "x, y or z"
