"""The estimator: pitch, pitch rate, position and velocity from the IMU and the range sensor."""
