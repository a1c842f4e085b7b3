"""Packets in and out by URL: UDP, TCP, serial lines, memory."""
