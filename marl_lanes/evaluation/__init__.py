"""Rollouts, metrics, the optimum and the figures."""
