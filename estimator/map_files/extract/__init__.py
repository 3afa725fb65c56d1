"""Building footprints out of local extracts of public data sets, in any of their formats and coordinate systems.

Begin with `get`. May import models.
"""
