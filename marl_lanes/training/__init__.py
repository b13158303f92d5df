"""What two learners share: live-transition filter, checkpoint, run folder."""
