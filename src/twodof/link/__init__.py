"""The wire: our MAVLink dialect, transports by URL, framing, signing, statistics, and a connection of all of them."""
