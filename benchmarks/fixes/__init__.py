"""Single fixes on rendered and recorded pairs: how accurate, how honest, from how far off."""
