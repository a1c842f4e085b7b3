"""Who gets which messages, how often, and how they are thinned on the way."""
