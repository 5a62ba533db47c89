"""Plan and Link to a recording: preflight checks, guard, the loop that commands, the recorder.

In go a Plan and an open Link; out comes a log on the disk and how the flight ended. Hover first, then the error.
"""
