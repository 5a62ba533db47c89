"""Nouns from and to the disk: logs of every format, cards, models and plans.

In go paths; out come Log, Card, Model and Plan, or the files themselves. From a damaged file everything readable is
recovered and the loss reported, or reading ends with an error of one line.
"""
