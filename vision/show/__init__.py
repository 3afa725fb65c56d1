"""Drawing into images. May import outline, describe, image."""
