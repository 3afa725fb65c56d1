"""Many flights: engine (dask.distributed), store (fsspec), a row a flight (Parquet), comparison.

Begin with `run` and `compare`. May import estimator.replay and the layers below it, logs and models.
"""
