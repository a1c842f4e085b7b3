"""The rig: a quadrotor that may only pitch and slide along a rail, from first principles, in the block language."""
