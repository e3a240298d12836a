"""From a picture of a plot to a record: NumPy, SciPy and Pillow on the host."""
