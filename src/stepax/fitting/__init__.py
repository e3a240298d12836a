"""The least-squares engine."""
