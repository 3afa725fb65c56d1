"""A trajectory as CSV, TUM, KML, GPX, Parquet, pandas DataFrame.

Begin with `export` and `frame`. May import logs.evaluation, logs.store, logs.wire and models.
"""
