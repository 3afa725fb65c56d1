"""Work on the ground: the demonstration, maps, overlays, checks before a flight, tuning. They do the work of commands.

Commands parse arguments and print, tools do it. May import everything of estimator but commands and cli.
"""
