"""MCAP files, torn ones too: read and written.

Begin with `reader` and `recorder`. May import logs.wire and models.
"""
