"""Light on puddles: where a ray meets water, what is reflected and what is refracted."""
