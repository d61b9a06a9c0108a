"""Ports of sensors: what their pins show, as words of events."""
