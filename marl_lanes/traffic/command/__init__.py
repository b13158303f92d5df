"""The life of a lane-change command: its gap, its phases, its outcome."""
