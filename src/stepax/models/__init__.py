"""Plants and their responses."""
