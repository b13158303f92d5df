"""The tasks of the benchmark, and the traffic that policies are measured on."""

TASKS = ("paper", "dense", "interactive", "adversarial", "five_lanes")
"""The shipped scenarios that are the tasks."""

NUM_MANEUVERS = 10_000
"""Of each task."""

SEED = 2_000_000
"""Of the traffic that a policy is measured on; no training and no choice may use it."""
