"""Whether a checkout of PX4 fits an exported module."""
