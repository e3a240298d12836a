"""Characteristic times of plants, and their inverses."""
