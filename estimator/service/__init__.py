"""The daemon.

    link (Zenoh, MAVLink) -> Inbox -> Daemon: one loop around Fusion.handle -> Outbox (the links again)
                                          |-> Log (a thread of its own)

Failures of links, log or state file do not stop it. May import estimator.frontend and the layers below it, logs, models.
"""
