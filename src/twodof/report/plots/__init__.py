"""What matplotlib draws: a flight, the figures of the report."""
