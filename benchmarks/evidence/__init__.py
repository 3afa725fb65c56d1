"""The evidence pack for the protection levels: claim, assumptions, faults, results, traceability, how to run it again."""
