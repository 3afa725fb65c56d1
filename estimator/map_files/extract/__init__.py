"""Building footprints from local extracts of public data sets. Begin with `get`. May import models."""
