"""A photo from a drone: its tags (EXIF and XMP), the pose and the camera in them, and its size and orientation.

May import estimator.commands.common, estimator.map_files, calib, vision and models; no command.
"""
