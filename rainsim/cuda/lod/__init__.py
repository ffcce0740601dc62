"""Twins of `rainsim.lod`."""
