"""What drivers do: longitudinal acceleration, and moving over."""
