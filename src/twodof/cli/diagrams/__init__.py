"""Commands that read diagrams."""
