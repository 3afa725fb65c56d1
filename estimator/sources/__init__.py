"""One file a source: checks of its messages, measurement, trust.

Pure: no I/O, no clock, no thread. Begin with `aids` and `base.aid`. May import models.
"""
