"""A log's trajectory for other programs: CSV, TUM, KML, GPX and Parquet files, a pandas DataFrame.

Begin with `export` and `frame`. May import logs.evaluation, logs.store, logs.wire and models.
"""
