"""Numbers without physics: random words, interpolation, pyramids of pictures, a bounding volume
tree.
"""
