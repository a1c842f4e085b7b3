"""Expression graphs: recorded, evaluated on numbers, differentiated, and their cost."""
