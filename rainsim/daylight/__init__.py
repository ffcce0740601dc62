"""The light that a capture was taken in: what of it was direct sun, and the capture without it."""
