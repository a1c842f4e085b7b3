"""What an editor asks of a diagram as one draws: answered by a warm process of its own, within a bounded time."""
