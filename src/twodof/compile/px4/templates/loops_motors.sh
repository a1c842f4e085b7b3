
# PX4's own loops above this controller, whose moment it reads as M_0, with the drone's gains.
param set-default MC_PITCHRATE_P 0.0854
param set-default MC_PITCHRATE_I 0.251
param set-default MC_PITCHRATE_D 0.00054
param set-default MC_PITCH_P 11
