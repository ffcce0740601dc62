"""Sensors in the rain: lenses that distort, rolling shutters, lidar, radar, drops on the glass."""
