"""How good a fit is: validation on other flights, paired tests, whiteness, uncertainty, plausibility, advice.

In go a Fit or a Model and Flights; out come Validation, findings, and the values that the pages show.
"""
