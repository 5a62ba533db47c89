"""`python -m rotorfit` is the command line."""

from rotorfit.app.cli import main

main()
