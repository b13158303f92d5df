"""Car following behind one leader, and the speed in curves."""
