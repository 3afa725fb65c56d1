"""One file a source.

Pure. Begin with `aids`, `base.aid`. May import models.
"""
