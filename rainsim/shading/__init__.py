"""Light on wet things: colour, Fresnel, wetting, sky, the wet-ground mirror, composition."""
