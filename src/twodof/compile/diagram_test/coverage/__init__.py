"""Which decisions of a diagram its tests took."""
