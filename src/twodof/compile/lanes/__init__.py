"""Many instances of one diagram at once, in the processor's vectors."""
