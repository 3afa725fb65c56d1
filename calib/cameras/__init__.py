"""One camera, a stereo rig, surveyed points. Begin with `mono`, `stereo`.

May import calib.board, calib.files, calib.errors, vision, models.
"""
