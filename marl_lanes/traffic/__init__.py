"""The simulation: numpy and numba only."""
