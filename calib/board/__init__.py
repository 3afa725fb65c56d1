"""The board in an image: chessboard and its corners. May import calib.errors, vision and models."""
