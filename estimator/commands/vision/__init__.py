"""Commands on images: locate, measure, overlay, bench.

May import estimator.commands.common, estimator.bench, estimator.tools, vision and calib.
"""
