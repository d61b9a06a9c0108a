"""What Python users hold: ``track``, ``Tracker``, ``flow``, and what they return."""
