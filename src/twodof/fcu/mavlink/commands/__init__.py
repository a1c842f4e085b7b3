"""Commands, set-points, excitations, the lease and lockstep over MAVLink."""
