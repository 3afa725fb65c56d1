"""Faulty streams of a log: stamps, values, axes.

    watch = Watch(origin)
    for message in messages:
        watch.add(message)
    for finding in watch.findings():        # the most likely cause first
        print(finding)

Memory is bounded. May import models.
"""

from logs.findings.streams import Finding, together
from logs.findings.watch import Watch

__all__ = ["Finding", "Watch", "together"]
