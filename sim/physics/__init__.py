"""What the world computes: blades, pairs, drives, air, the body, and what sensors read of them."""
