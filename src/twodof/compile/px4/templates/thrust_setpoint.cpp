    _thrust_setpoint = _mode.flag_control_attitude_enabled
               ? setpoint(-_attitude_setpoint.thrust_body[2], _attitude_setpoint.timestamp, 0.f, ${wanted})
               : setpoint(-_rates_setpoint.thrust_body[2], _rates_setpoint.timestamp, 0.f, ${wanted});
