"""What goes wrong in a calibration."""


class CalibrationError(ValueError):
    """An unusable file, recording or set of images, in one line."""
