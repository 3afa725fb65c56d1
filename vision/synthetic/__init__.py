"""Rendered stereo images of known worlds.

May import models.
"""

from vision.synthetic.camera_effects import IDEAL, Conditions, Image, blur_of_motion
from vision.synthetic.ground import Ground
from vision.synthetic.render import render, render_labels, render_pair
from vision.synthetic.rigs import draw_rig, make_rig
from vision.synthetic.scenes import Scene, WorldSpec, make_world
from vision.synthetic.truth import LandmarkView, Stretch, landmark_views
from vision.synthetic.world import Appearance, Solid, Sun, World

__all__ = [
    "IDEAL",
    "Appearance",
    "Conditions",
    "Ground",
    "Image",
    "LandmarkView",
    "Scene",
    "Solid",
    "Stretch",
    "Sun",
    "World",
    "WorldSpec",
    "blur_of_motion",
    "draw_rig",
    "landmark_views",
    "make_rig",
    "make_world",
    "render",
    "render_labels",
    "render_pair",
]
