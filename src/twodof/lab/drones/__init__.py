"""The drones that the server is connected to: kept connected, commanded for the page, recorded."""
