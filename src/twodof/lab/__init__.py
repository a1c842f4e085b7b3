"""Laboratory in a browser: a web server over drones, logs, identification and diagrams."""
