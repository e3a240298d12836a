"""Plants as layers of larger programs, and parameters without bounds."""
