"""Who learns: what a changer and a follower see, do and are paid."""
