    const bool along_rail = _mode.flag_control_velocity_enabled || _mode.flag_control_position_enabled;
    (void)sample;

    if (!along_rail) {
        return; // the attitude set-point is another's
    }

    // The heading stays as it is: q_d is a turn by it, then by the pitch.
    const float heading = sqrtf(_attitude.q[0] * _attitude.q[0] + _attitude.q[3] * _attitude.q[3]);
    const float w = heading > 0.f ? _attitude.q[0] / heading : 1.f;
    const float z = heading > 0.f ? _attitude.q[3] / heading : 0.f;
    const float half = _active ? 0.5f * ${pitch} : 0.f;

    vehicle_attitude_setpoint_s attitude_setpoint{};
    attitude_setpoint.q_d[0] = w * cosf(half);
    attitude_setpoint.q_d[1] = -z * sinf(half);
    attitude_setpoint.q_d[2] = w * sinf(half);
    attitude_setpoint.q_d[3] = z * cosf(half);
    attitude_setpoint.thrust_body[2] = _active ? -limited(${thrust}, 0.f, 1.f) : 0.f;
    attitude_setpoint.timestamp = hrt_absolute_time();
    send(_vehicle_attitude_setpoint_pub, attitude_setpoint);
