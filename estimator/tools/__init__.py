"""Ground tools.

May import everything of estimator but commands and cli.
"""
