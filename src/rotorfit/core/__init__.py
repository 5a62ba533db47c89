"""The nouns: Log, Card, Flight, Model, Fit, Validation, Plan, Finding, with the axes, units, limits and errors
they need.

Nothing comes in: every other package takes these values and passes them on. The package imports numpy and nothing else
of rotorfit, so that importing a noun is cheap.
"""
