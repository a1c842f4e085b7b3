"""The vehicle's parameters: their table, their values and the file that keeps them."""
