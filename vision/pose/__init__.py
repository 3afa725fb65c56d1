"""Pose of the vehicle from identified landmarks: observations, least squares, covariance, undetermined directions.

Begin with `pose`. May import outline, identify and the layers below them.
"""
