"""Flights on disk: CDR messages in MCAP files, written, read, imported and judged. ENU and FLU end in wire/codec.py.

May import models.
"""
