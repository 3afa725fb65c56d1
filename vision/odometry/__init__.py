"""Visual odometry: the motion of the body between two stereo pairs, as pure functions. Begin with `step`.

May import vision.records and the layers below it.
"""
