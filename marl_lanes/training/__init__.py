"""What learners share: the loop, configuration, checkpoints, run folder, live transitions."""
