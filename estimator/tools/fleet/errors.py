"""What stops a whole run."""


class FleetError(ValueError):
    """Nothing can be run or compared; one line for a person."""
