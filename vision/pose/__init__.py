"""Pose from identified landmarks.

Begin with `pose`. May import outline, identify and the layers below them.
"""
