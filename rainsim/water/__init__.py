"""The parts of `rainsim.grid`, and other water: schemes, friction, puddles, ripples."""
