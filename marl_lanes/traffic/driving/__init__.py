"""What every vehicle does: how fast it goes, and when it makes way."""
