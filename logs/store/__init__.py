"""MCAP files: read, torn ones too, and written.

Begin with `reader` and `recorder`. May import logs.wire and models.
"""
