"""Commands on images.

May import estimator.commands.common, estimator.bench, estimator.tools, vision and calib.
"""
