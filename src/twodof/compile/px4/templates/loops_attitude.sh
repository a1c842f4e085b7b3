
# PX4's own loops below this controller, with the drone's gains.
param set-default MC_PITCHRATE_P 0.1208
param set-default MC_PITCHRATE_I 0.355
param set-default MC_PITCHRATE_D 0.00076
param set-default MC_PITCH_P 11
