"""Pose from identified landmarks: observations, least squares, covariance, open directions.

Begin with `pose`. May import outline, identify and the layers below them.
"""
