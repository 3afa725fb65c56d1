"""Maps: a million footprints, footprints found in a satellite image."""
