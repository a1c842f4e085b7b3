"""Long computations in processes of their own, with progress and cancel."""
