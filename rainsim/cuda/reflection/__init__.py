"""Twins of `rainsim.reflection`."""
