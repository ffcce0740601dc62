"""What `rainsim.grid` calls, and water beside the solver: schemes, friction, puddles, ripples."""
