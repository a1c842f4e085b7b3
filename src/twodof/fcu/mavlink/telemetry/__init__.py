"""What the vehicle tells by itself: streams, batches and their messages."""
