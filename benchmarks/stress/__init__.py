"""What differences between world and configuration cost: perturbed messages through landfix and the plain filter."""
