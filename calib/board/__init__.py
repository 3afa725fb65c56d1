"""The board in a picture: chessboard and its corners. May import calib.errors, vision and models."""
