"""The road, and how a vehicle moves on it."""
