"""Flights on disk: CDR messages in MCAP files, written, read, imported, judged; ENU and FLU end in wire/codec.py.

May import models.
"""
