"""Commands that read flight logs."""
