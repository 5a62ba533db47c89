"""Nouns from and to the disk: logs of every format, cards, models and plans.

In go paths; out come Log, Card, Model and Plan, or the files themselves. A damaged file gives what can be recovered
and says what was lost, or one line of error.
"""
