"""The law of one vehicle behind another, and its speed in curves."""
