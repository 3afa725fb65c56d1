"""Bytes from outside: bounds and boundary.

    limits          the bounds, relative to the compressed size and absolute
    file            a file that a person names
    gzip            a gzip file, as a stream
    image_header    size and depth of an image, before it is decoded
    toml_text       TOML -> table, errors in one line
    boundary        any exception -> one line: file, function, reason

May import nothing but numpy.
"""
