"""Ground tools: demonstration, maps, overlays, checks, tuning; commands parse and print.

May import everything of estimator but commands and cli.
"""
