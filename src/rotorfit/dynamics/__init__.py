"""What a law does: response to held commands, sensitivities, disturbance filter, predictor, prediction protocol.

In go coefficients and commands; out come motion, likelihood terms and predictions. The package knows laws, not methods
of estimation.
"""
