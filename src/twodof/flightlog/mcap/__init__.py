"""MCAP, the container that Foxglove Studio and rosbags open: the format in which the project records."""
