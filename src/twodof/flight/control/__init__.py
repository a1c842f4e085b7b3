"""The loops: position, velocity, attitude and pitch rate, their cascade, and the mixer to the rotor pairs."""
