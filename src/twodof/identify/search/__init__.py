"""Searches for unknowns: least squares, from several first guesses, and linear models without any."""
