"""Work on the ground: the demonstration, maps, overlays, checks before a flight, tuning; commands parse arguments and print.

May import everything of estimator but commands and cli.
"""
