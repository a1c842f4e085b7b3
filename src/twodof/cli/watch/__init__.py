"""`twodof watch`: drones in a terminal, as they fly."""
