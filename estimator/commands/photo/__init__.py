"""Photos from drones: tags, pose, camera, orientation.

May import estimator.commands.common, estimator.map_files, calib, vision, models.
"""
