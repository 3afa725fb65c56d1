"""Drawing into images: the map's outlines, what was measured. May import outline, describe and image."""
