"""Flights on disk: CDR in MCAP; ENU and FLU end in wire/codec.py.

May import models.
"""
