"""Visual odometry: the motion of the body between two stereo pairs. Pure functions on arrays; begin with `step`.

May import vision.records and what is below it.
"""
