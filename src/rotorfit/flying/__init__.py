"""Flying: from a plan and a link to a recording, with preflight checks, guard, command loop and recorder.

A Plan and an open Link go in; a log on the disk and the ending of the flight come out. Whatever goes wrong, the vehicle
hovers first, and then the error is reported.
"""
