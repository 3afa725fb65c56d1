"""Messages as bytes. Begin with `codec`, `schemas`.

May import models.
"""
