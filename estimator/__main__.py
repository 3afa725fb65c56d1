"""python -m estimator: the command line without an installed entry point."""

from estimator.cli import main

main()
