"""A block diagram as a picture: its layout, its symbols, its SVG."""
