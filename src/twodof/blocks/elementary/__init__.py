"""Elementary functions, written in the block language: every target computes the same bits."""
