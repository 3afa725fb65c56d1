"""When the estimate begins and how good it is from then on: recorded flights, and vehicles that show no heading."""
