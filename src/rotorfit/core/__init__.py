"""The nouns: Log, Card, Flight, Model, Fit, Validation, Plan, Finding, with the axes, units, limits and errors
they need.

Nothing comes in; every other package takes these values and hands them on. It imports numpy and nothing of rotorfit,
so that naming a noun costs nothing.
"""
