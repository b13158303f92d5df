"""The basis of all kernels: compilation, memory and random numbers."""
