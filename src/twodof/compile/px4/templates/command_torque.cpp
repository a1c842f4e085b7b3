
    if (!_mode.flag_control_rates_enabled) {
        return; // another module commands torque and thrust, or nobody does
    }

    const float thrust = ${thrust};

    // Thrust first: the control allocator runs on the torque.
    vehicle_thrust_setpoint_s thrust_setpoint{};
    thrust_setpoint.timestamp_sample = sample;
    thrust_setpoint.xyz[2] = _active ? -limited(thrust, 0.f, 1.f) : 0.f;
    thrust_setpoint.timestamp = hrt_absolute_time();
    send(_vehicle_thrust_setpoint_pub, thrust_setpoint);

    vehicle_torque_setpoint_s torque_setpoint{};
    torque_setpoint.timestamp_sample = sample;
    torque_setpoint.xyz[1] = _active ? _torque_scale * limited(${moment}, -1.f, 1.f) : 0.f;
    torque_setpoint.timestamp = hrt_absolute_time();
    send(_vehicle_torque_setpoint_pub, torque_setpoint);
