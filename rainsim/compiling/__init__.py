"""Compiling: the kept machine code, the recorded list of kernels, and the worker processes."""
