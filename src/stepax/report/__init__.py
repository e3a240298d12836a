"""What a result says: content, terminal, files."""
