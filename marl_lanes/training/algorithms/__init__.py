"""Algorithms of a learner: losses with their optimizers, schedules and policies."""
