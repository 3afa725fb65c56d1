"""Visual odometry. Begin with `step`.

May import vision.records and the layers below it.
"""
