"""Light on puddles: where a ray meets water, the reflected light and the refracted light."""
