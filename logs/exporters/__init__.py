"""A trajectory as CSV, TUM, KML, GPX, Parquet, pandas DataFrame.

Begin with `export`. May import logs.evaluation, logs.store, logs.wire, models.
"""
