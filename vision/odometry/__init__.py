"""Visual odometry: motion of the body between two stereo pairs. Begin with `step`.

May import vision.records and the layers below it.
"""
