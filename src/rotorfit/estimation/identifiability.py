"""Widths of intervals beyond which a coefficient is not identifiable, and the shortest usable time."""

LEAST_TIME = 5.0
"""Shortest usable time for which an axis is fitted [s]."""

TOLERABLE = {True: 0.25, False: 0.05}
"""Half width of an interval, of a logarithm (True) or else [s], up to which a wrong law is good enough: the interval
includes the error that the tests detect, and is still useful."""

WIDEST_INPUT = 10.0
"""Ratio of the ends of the input gain's interval beyond which the gain is not identifiable."""

WIDEST_DELAY = 0.4
"""Width of the delay's interval beyond which the delay is not identifiable [s]."""
