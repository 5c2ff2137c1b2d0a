"""References that a robot shall follow, and the whole-body motion that follows them."""
