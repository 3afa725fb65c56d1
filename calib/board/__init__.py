"""The board in an image. May import calib.errors, vision, models."""
