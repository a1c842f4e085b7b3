"""MAVLink: our dialect, frames, messages by name, modes, rates, file transfer."""
