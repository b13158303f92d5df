"""Trained policies that ship with the package: weights, and what is known of each."""
