"""From a program to readable C99."""
