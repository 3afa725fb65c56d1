"""Calibration against known truth and on published recordings."""
