"""Least squares on held-out blocks: the problem, its algebra, the joint model of base and effects."""
