"""Half widths of 95 % intervals in standard errors."""

NORMAL = 1.959963984540054
"""97.5 % point of the normal distribution."""


def student_quantile(freedom: float) -> float:
    """97.5 % point of Student's t distribution."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))
