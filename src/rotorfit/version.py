"""The version of rotorfit."""

__version__ = "0.1.0"
