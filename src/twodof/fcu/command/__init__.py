"""Command: lease, arming, modes, set-points and excitations, as inputs of the flight code."""
