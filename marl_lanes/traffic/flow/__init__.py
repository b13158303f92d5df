"""Who enters the road, and who leaves it."""
