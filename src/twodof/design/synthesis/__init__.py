"""Controllers from a model and what is asked of them."""
