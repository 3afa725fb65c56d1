"""The daemon.

    link (Zenoh, MAVLink) -> Inbox -> Daemon: one loop around Fusion.handle -> Outbox (the links again)
                                          |-> Log (a thread of its own)

Failures of links, log, state file or watchdog do not stop the loop. May import estimator.frontend and the layers below it, logs
and models.
"""
