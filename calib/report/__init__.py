"""What a calibration is worth: verdicts, pictures of residuals and coverage, the page.

May import calib.cameras and what is below it.
"""
