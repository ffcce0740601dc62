"""Twins of `rainsim.splatting`."""
