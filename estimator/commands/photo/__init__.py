"""A photo from a drone: its tags (EXIF and XMP), the pose and the camera they tell of, and its size and orientation.

Imports models and calib; what reads a file imports Pillow or OpenCV where it needs them, so that --help is fast.
"""
