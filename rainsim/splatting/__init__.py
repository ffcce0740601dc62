"""The kernels behind `rainsim.raster`: projection, tile lists, blending."""
