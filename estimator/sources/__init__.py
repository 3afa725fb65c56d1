"""One file a source: checks of its messages, measurement, trust.

Pure. Begin with `aids`, `base.aid`. May import models.
"""
