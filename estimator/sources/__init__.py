"""One file a source: what makes its messages usable, what measurement they are, and how far the source is trusted.

Pure: no I/O, no clock, no thread. Begin with `aids` and `base.aid`. May import models.
"""
