"""Monte Carlo: random plants, noise, methods, and what came of them, chunk by chunk."""
