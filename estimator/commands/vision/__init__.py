"""Commands that look at pictures: locate, measure, overlay, bench.

May import estimator.commands.common, estimator.bench, estimator.tools, vision and calib.
"""
