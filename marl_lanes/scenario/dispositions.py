"""The names of followers' dispositions, which the help of the command line has, too."""

SCRIPTED = ("cooperative", "neutral", "adversarial")
"""The dispositions with a formula in the simulation, in the order of their codes."""

LEARNED = "learned"
"""The disposition that a checkpoint or a learner drives."""
