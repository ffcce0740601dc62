"""Many processes at one run: on this machine or on many, with the same frames to the byte."""
