"""Many flights at once: the engine (dask.distributed), the store (fsspec), a row a flight (Parquet), two runs compared.

Begin with `run` and `compare`. May import estimator.replay and the layers below it, logs and models.
"""
