"""Photos from drones: tags (EXIF, XMP), pose and camera from them, size and orientation.

May import estimator.commands.common, estimator.map_files, calib, vision and models; no command.
"""
