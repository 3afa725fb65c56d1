"""What goes wrong in a calibration, in one line that says what to do."""


class CalibrationError(ValueError):
    """A file, a recording or a set of images that cannot be used; the text is one line for the person who made it."""
