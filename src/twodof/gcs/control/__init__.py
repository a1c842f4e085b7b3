"""What a drone is told: set-points, excitations, parameters, controllers."""
