"""Formats: every kind of file that a model is exported to."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes:
        suffix: Of its files.
        text: What it is, for a list.
        template: In `templates`.
        linear: Whether it holds linear laws only.
        plain: Whether it holds the default law only, with or without its delay.
        needs: What one needs to use it.
    """

    suffix: str
    text: str
    template: str
    linear: bool = False
    plain: bool = False
    needs: str = ""


FORMATS: Mapping[str, Format] = {
    "python-control": Format(
        ".py", "linear state space at a heading: continuous, sampled with the exact delay, Pade",
        "python_control.py.j2", linear=True, needs="pip install 'rotorfit[control]'",
    ),
    "casadi": Format(
        ".py", "CasADi functions for MPC: right-hand side, exact-delay step, model for acados", "casadi.py.j2",
        needs="pip install 'rotorfit[casadi]'; CasADi is LGPL",
    ),
    "numpy": Format(".py", "NumPy functions: right-hand side, step, simulation; any batch", "numpy.py.j2"),
    "jax": Format(
        ".py", "the same in JAX: jit, grad, vmap", "numpy.py.j2", needs="pip install 'rotorfit[jax]'",
    ),
    "matlab": Format(".m", "MATLAB and Octave: functions, and the state space at a heading", "matlab.m.j2"),
    "c": Format(".h", "C99 header: fixed-step predictor without allocation", "c.h.j2"),
    "ros1": Format(".yaml", "ROS 1 parameters, with K as drone_dev takes it", "ros1.yaml.j2"),
    "ros2": Format(".yaml", "ROS 2 parameters, with K as drone_dev takes it", "ros2.yaml.j2"),
    "rotorpy": Format(
        ".py", "vehicle for RotorPy's Environment that moves as the model does", "rotorpy.py.j2",
        needs="pip install 'rotorfit[rotorpy]'",
    ),
    "gazebo": Format(
        ".xacro", "gains of Gazebo's MulticopterVelocityControl; what it cannot hold is said", "gazebo.xacro.j2",
        plain=True,
    ),
}  # fmt: skip
"""Every format by its name."""
