"""The daemon.

    link (Zenoh, MAVLink) -> Inbox -> Daemon: one loop around Fusion.handle -> Outbox (the links again)
                                          |-> Log (a thread of its own)

    base -> autopilot -> mavlink, zenoh, log -> daemon, vision -> run, which puts everything together

A link is an Inbox's source and an Outbox (ports.py). A failure of links, log, state file or watchdog does not stop the loop.
May import estimator.frontend and the layers below it, logs and models.
"""
