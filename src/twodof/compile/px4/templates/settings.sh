# A symmetric quadrotor X: motors 1 and 3 are the fore pair, 2 and 4 the aft pair.
param set-default CA_AIRFRAME 0
param set-default CA_ROTOR_COUNT 4
param set-default CA_ROTOR0_PX 0.15
param set-default CA_ROTOR0_PY 0.15
param set-default CA_ROTOR1_PX -0.15
param set-default CA_ROTOR1_PY -0.15
param set-default CA_ROTOR2_PX 0.15
param set-default CA_ROTOR2_PY -0.15
param set-default CA_ROTOR3_PX -0.15
param set-default CA_ROTOR3_PY 0.15
param set-default CA_ROTOR0_KM 0.05
param set-default CA_ROTOR1_KM 0.05
param set-default CA_ROTOR2_KM -0.05
param set-default CA_ROTOR3_KM -0.05

# The gyro at a whole number of samples a step.
param set-default IMU_GYRO_RATEMAX 1000

# Indoors, without satellites: the position comes as VISION_POSITION_ESTIMATE.
param set-default SYS_HAS_GPS 0
param set-default EKF2_GPS_CTRL 0
param set-default EKF2_EV_CTRL 11
param set-default EKF2_HGT_REF 3
param set-default EKF2_EV_DELAY 0

# On the rig nobody takes off or lands, and PX4 could take a flight for standing on the ground: no disarming for that.
param set-default COM_DISARM_PRFLT -1
param set-default COM_DISARM_LAND -1

# The loss of Offboard with no remote control disarms.
param set-default COM_OBL_RC_ACT 7
