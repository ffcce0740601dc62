"""Water in the air as the camera sees it: streaks, fog, splashes."""
