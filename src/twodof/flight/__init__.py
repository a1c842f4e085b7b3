"""Flight code as diagrams: estimator, cascade, mixer, level hold, failsafe, and the core that joins them."""
