"""rotorfit: from a flight log to a trustworthy model of a velocity-commanded multirotor."""

__version__ = "0.1.0"
