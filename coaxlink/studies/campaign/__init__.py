"""Many flights and many logs: what is varied, the engine that runs it, the rows, and what they say.

`spec` reads a campaign file, `cells` draws its flights, `engine` runs work on one machine or on Dask,
`dataset` keeps rows in Parquet, `summary` weighs them; `fleet` does the same for a folder of logs.
"""
