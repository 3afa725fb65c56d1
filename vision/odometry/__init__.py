"""Visual odometry: the motion of the body between two stereo pairs. Pure functions on arrays; begin with `step`.

May import vision.image and what is below it.
"""
