"""What a record is, where it comes from, and what can be read off it."""
