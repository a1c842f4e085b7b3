"""Flight code: estimator, cascade, mixer, level hold, and the core that joins them. All of it diagrams."""
