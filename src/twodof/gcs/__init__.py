"""The ground's API: `Drone` for scripts and notebooks, `AsyncDrone` for programs; what Drone Cmd is to MATLAB."""
