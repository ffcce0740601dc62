"""The parts of `rainsim.drops`: drop sizes, Poisson cells, height fields, wind, drips."""
