"""Vehicles that enter the road, and vehicles that leave it."""
