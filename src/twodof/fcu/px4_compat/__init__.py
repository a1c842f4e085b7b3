"""What only PX4's clients need, such as QGroundControl, MAVSDK and PlotJuggler."""
