"""What a learner can learn with: losses, their optimisers, schedules and policies."""
