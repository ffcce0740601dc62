"""From states of the water to pictures."""
