"""Building footprints from local extracts. Begin with `get`. May import models."""
