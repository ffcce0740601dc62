"""Twins of `rainsim.rain`."""
