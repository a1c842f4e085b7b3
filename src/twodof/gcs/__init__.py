"""The ground's API: `Drone` for scripts and notebooks, `AsyncDrone` for programs; what Drone Cmd is to MATLAB."""

from twodof.gcs.async_drone import AsyncDrone as AsyncDrone
from twodof.gcs.discovery import discover as discover
from twodof.gcs.drone import Drone as Drone
