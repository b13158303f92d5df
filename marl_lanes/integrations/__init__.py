"""Adapters for learners of others, each imported by itself where the other package is installed."""
