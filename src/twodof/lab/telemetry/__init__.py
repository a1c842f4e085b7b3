"""Telemetry for many browsers: rows by tick, decimated once for all who want the same, dropped where one is slow."""
