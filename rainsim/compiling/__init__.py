"""Compiling: what machine code is kept for, the recorded list of kernels, and the processes."""
