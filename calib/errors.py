"""What goes wrong in a calibration, in one line that says what to do."""


class CalibrationError(ValueError):
    """A file, recording or set of images that cannot be used; the text is one line for a person."""
