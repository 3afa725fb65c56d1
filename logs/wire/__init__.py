"""Messages as bytes: CDR, type texts, axes, stamps. Begin with `codec` and `schemas`.

May import models.
"""
