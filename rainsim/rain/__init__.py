"""What `rainsim.drops` calls: drop sizes, Poisson cells, height fields, wind, drips."""
