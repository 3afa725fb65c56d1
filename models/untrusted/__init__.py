"""The door for bytes from outside: how much may be unpacked or decoded of how few, and one boundary for what cannot be read.

    limits          the bounds, relative to the compressed size and absolute
    gzip            a gzip file, as a stream
    image_header    size and depth of an image, before it is decoded
    toml_text       TOML -> table; whatever the text, what is wrong with it is one line
    boundary        any exception -> one line: file, place, reason

May import nothing but numpy.
"""
