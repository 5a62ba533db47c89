"""Model to controller: gains, margins under the model's uncertainty, and a trial flight.

In goes a Model; out come a Tuning and the errors of its trial.
"""
