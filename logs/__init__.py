"""Flights on disk: CDR messages in MCAP files, written, read (torn ones too), imported, and judged.

Wire conventions (ENU, FLU) end in wire/codec.py. May import models.
"""
