"""Which stream of a log is at fault: its stamps, its values or its axes. What was found names the odd one out.

    watch = Watch(origin)
    for message in messages:
        watch.add(message)
    for finding in watch.findings():        # the most likely cause first
        print(finding)

Each cause is one function of the collected streams. Memory is bounded: a long log is judged stretch by stretch.
May import models.
"""

from logs.findings.streams import Finding
from logs.findings.watch import Watch

__all__ = ["Finding", "Watch"]
