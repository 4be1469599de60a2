"""Many simulated flights from one file: `spec` says which, `flights` flies them, `rows` keeps them,
`summary` weighs them.
"""
