"""What a drone tells: signals, samples at full rate, its state, its words, recordings of them."""
