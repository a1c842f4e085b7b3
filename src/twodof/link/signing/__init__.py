"""MAVLink 2 signing: keys, time stamps, and which frames are let in."""
