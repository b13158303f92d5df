"""Pictures of the traffic, drawn from the rows of one time step; rendering never steps."""
