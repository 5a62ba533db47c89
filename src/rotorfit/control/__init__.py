"""Control: from a model to a controller, with its margins under the model's uncertainty and a trial flight.

A Model goes in; a Tuning and the tracking errors of its trial come out.
"""
