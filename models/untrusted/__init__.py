"""Bytes from outside: bounds on unpacking and decoding, and one boundary for their errors. May import numpy."""
