"""The grey-box likelihood: blocks of poses, search for optima, Fisher scoring, profiles, choice of the law."""
