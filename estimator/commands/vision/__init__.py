"""Commands on images.

May import estimator.commands.common, estimator.tools, vision and calib.
"""
