"""One file a command: arguments, the call, output.

Heavy imports stand inside functions. May import everything but cli.
"""
