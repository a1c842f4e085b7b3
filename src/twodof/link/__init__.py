"""The wire: transports by URL, our MAVLink dialect, signing, and a connection that joins them."""
