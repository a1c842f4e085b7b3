"""Pictures by matplotlib: flights, loops, fits, and the figures of the report."""
