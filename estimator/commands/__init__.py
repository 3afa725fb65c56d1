"""One file a command: arguments, the call, output.

Heavy imports stand inside the functions, for a fast `landfix --help`. May import everything but cli.
"""
