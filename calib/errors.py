"""What goes wrong in a calibration, in one line that says what to do."""


class CalibrationError(ValueError):
    """An unusable file, recording or set of images, in one line."""
