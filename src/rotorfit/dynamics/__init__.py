"""What a law does: response to held commands, sensitivities, disturbance filter, predictor, prediction protocol,
physics.

In go coefficients and commands; out come motion, likelihood terms and predictions. It knows laws, not methods of
estimation.
"""
