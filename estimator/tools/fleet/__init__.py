"""Many flights at once: the engine (dask.distributed), the store (fsspec), a row a flight (Parquet), two runs compared.

Begin with `run` and `compare`. May import estimator.replay and what is below it, logs and models.
"""
