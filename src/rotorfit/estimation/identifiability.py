"""Widths beyond which data have not told a coefficient, and the least time that can."""

NORMAL = 1.959963984540054
"""97.5 % point of the normal distribution."""

LEAST_TIME = 5.0
"""Time that can be used below which an axis is too short to tell anything [s]."""

WIDEST_INPUT = 10.0
"""Ratio of the ends of the input gain's interval beyond which it is not identifiable."""

WIDEST_DELAY = 0.4
"""Width of the delay's interval beyond which it is not identifiable [s]."""
