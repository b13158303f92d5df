"""What kernels are made of: how they are compiled, their memory and random numbers."""
