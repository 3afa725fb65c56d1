"""One file a command: arguments, the call, what is printed. The work itself is done by the modules they call.

Heavy imports stand inside the functions, so that `landfix --help` is fast. What commands share is in `common`.
May import everything but cli.
"""
