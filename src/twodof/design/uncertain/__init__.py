"""What an identified family of drones does under a controller: robustness, promise, verdict."""
