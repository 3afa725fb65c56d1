"""One camera, a stereo rig, surveyed points: estimate, bundle adjustment, covariance. Begin with `mono` and `stereo`.

May import calib.board, calib.files and calib.errors, vision and models.
"""
