"""What the machine can do: C compiled on the spot, and matrix products alone."""
