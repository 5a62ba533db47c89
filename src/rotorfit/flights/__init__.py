"""Log and Card to Flight: columns, streams, clocks, repairs.

In go a Log and the Card that defines its columns; out comes a Flight in SI units with every repair as a note.
"""
