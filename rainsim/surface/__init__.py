"""One surface of a capture: where its cameras agree that something stands, found once."""
