"""`python -m rotorfit` is the command line."""

from rotorfit.cli import main

main()
