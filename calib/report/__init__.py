"""What a calibration is worth: verdicts, images of residuals and coverage, the page.

May import calib.cameras and what is below it.
"""
