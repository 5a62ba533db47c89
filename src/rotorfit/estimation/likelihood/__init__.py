"""The grey-box likelihood: blocks of poses, search for optima, climb, profile, choice of the law."""
