
    actuator_motors_s motors{}; // NaN stops a motor
    motors.timestamp_sample = sample;
${motors}

    for (int i = 4; i < 12; i++) {
        motors.control[i] = NAN;
    }

    motors.timestamp = hrt_absolute_time();
    send(_actuator_motors_pub, motors);
