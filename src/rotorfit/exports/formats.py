"""Formats: every kind of file to which a model can be exported. Command line and studio list this table.

A new format is a template in `templates` and one row here.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Language:
    """The syntax of a programming language that the laws need.

    Attributes:
        absolute: Name of the function |a|.
        larger: Name of the function max(a, b).
        smaller: Name of the function min(a, b).
        root: Name of the square root.
        prefix: Prefix of the names of constants; `{NAME}` stands for the name of the vehicle in capitals.
        zero: 0 as a float.
    """

    absolute: str
    larger: str
    smaller: str
    root: str
    prefix: str = ""
    zero: str = "0.0"


@dataclass(frozen=True)
class Format:
    """A kind of file.

    Attributes:
        suffix: Suffix of its files.
        text: Description for a list.
        template: Name of its template in `templates`.
        summary: Contents of a file, for the header of the file.
        language: Language of the laws that it integrates by Runge-Kutta; None if it has none.
        linear: Whether it can hold linear laws only.
        plain: Whether it can hold the default law only, with or without its delay.
        steady: Whether it needs a steady speed on all four axes.
        named: Whether the file must have the name of the function in it.
        needs: Software that is needed to use it.
        sampled: Whether its files are for one sample period; the others take any when they are used.
    """

    suffix: str
    text: str
    template: str
    summary: str
    language: Language | None = None
    linear: bool = False
    plain: bool = False
    steady: bool = False
    named: bool = False
    needs: str = ""
    sampled: bool = False


NUMPY = Language("np.abs", "np.maximum", "np.minimum", "np.sqrt")

FORMATS: Mapping[str, Format] = {
    "python-control": Format(
        ".py",
        "linear state space at a heading: continuous, sampled with the exact delay, Pade",
        "python_control.py.j2",
        "Linear state space at a fixed heading for python-control, with the exact delay when sampled.",
        linear=True,
        needs="pip install 'rotorfit[control]'",
    ),
    "casadi": Format(
        ".py",
        "CasADi functions for MPC: right-hand side, exact-delay step, model for acados",
        "casadi.py.j2",
        "CasADi functions: the right-hand side, and a step of any sample period with the exact delay.",
        Language("ca.fabs", "ca.fmax", "ca.fmin", "ca.sqrt"),
        needs="pip install 'rotorfit[casadi]'; CasADi is LGPL",
    ),
    "numpy": Format(
        ".py",
        "NumPy functions: right-hand side, step, simulation; any batch",
        "numpy.py.j2",
        "NumPy functions: the right-hand side, and steps of any length with the exact delay.",
        NUMPY,
    ),
    "jax": Format(
        ".py",
        "the same in JAX: jit, grad, vmap",
        "numpy.py.j2",
        "JAX functions: the right-hand side, and steps of any length with the exact delay.",
        Language("jnp.abs", "jnp.maximum", "jnp.minimum", "jnp.sqrt"),
        needs="pip install 'rotorfit[jax]'",
    ),
    "matlab": Format(
        ".m",
        "MATLAB and Octave: functions, and the state space at a heading",
        "matlab.m.j2",
        "Functions for MATLAB and Octave: the right-hand side, steps of any length with the exact delay, and the "
        "state space at a fixed heading where the laws are linear.",
        Language("abs", "max", "min", "sqrt", prefix="p."),
        named=True,
    ),
    "c": Format(
        ".h",
        "C99 header: fixed-step predictor without allocation",
        "c.h.j2",
        "C99 predictor of a fixed step with the exact delay. It allocates nothing and needs math.h only.",
        Language("fabs", "fmax", "fmin", "sqrt", prefix="{NAME}_"),
        sampled=True,
    ),
    "ros1": Format(
        ".yaml",
        "ROS 1 parameters, with K as drone_dev takes it",
        "ros1.yaml.j2",
        "Parameters for ROS 1, to be loaded by rosparam or a launch file.",
    ),
    "ros2": Format(
        ".yaml",
        "ROS 2 parameters, with K as drone_dev takes it",
        "ros2.yaml.j2",
        "Parameters of a ROS 2 node, to be loaded as a parameter file.",
    ),
    "rotorpy": Format(
        ".py",
        "vehicle for RotorPy's Environment that moves as the model does",
        "rotorpy.py.j2",
        "A vehicle for RotorPy's Environment, which moves exactly as the model does; it has no rotors.",
        NUMPY,
        needs="pip install 'rotorfit[rotorpy]'",
    ),
    "gazebo": Format(
        ".xacro",
        "gains of Gazebo's MulticopterVelocityControl; what it cannot hold is said",
        "gazebo.xacro.j2",
        "A xacro macro with the gains of Gazebo's MulticopterVelocityControl.",
        plain=True,
        steady=True,
    ),
}
"""Every format by its name."""
