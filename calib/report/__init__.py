"""Quality of a calibration: verdicts, plots, page.

May import calib.cameras and what is below it.
"""
