"""Expression graphs: their recording, their evaluation on numbers, their derivatives and their cost."""
