"""Facts about the platform that several rooms need: the control period, gravity, the rail, the thrust of hover."""

PERIOD = 0.004
"""Control period [s]: the flight code and every user's controller run at 250 Hz."""

GRAVITY = 9.81
"""Standard gravity as the course rounds it [m/s2]."""

RAIL_CENTRE = 0.50
"""What the range sensor measures with the cart at the middle of the rail [m]: x = dist - 0.50."""

HOVER = 0.4
"""The thrust command at which the drone is flown, and at which its trim and friction are stated."""
