"""Files over MAVLink: FTP, component metadata and log download."""
