"""Trajectories as data: one row for each vehicle and time step; every picture stands on them."""
