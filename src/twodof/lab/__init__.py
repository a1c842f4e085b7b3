"""The laboratory in a browser: a web server over drones, logs, identification and diagrams. It translates, no more."""
