"""Bytes from outside: bounds on unpacking and decoding, one boundary for unreadable files.

    limits          the bounds, relative to the compressed size and absolute
    file            a file that a person names
    gzip            a gzip file, as a stream
    image_header    size and depth of an image, before it is decoded
    toml_text       TOML -> table, errors in one line
    boundary        any exception -> one line: file, function, reason

May import nothing but numpy.
"""
