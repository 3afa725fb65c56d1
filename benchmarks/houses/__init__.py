"""Footprints of real houses under real aerial and satellite images of some twenty towns."""
