"""The key families by name; ``prng`` makes them."""

FAMILIES = ("threefry", "pcg4d")
