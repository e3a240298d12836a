"""What one result says: intervals, text, a table for notebooks, JSON."""
