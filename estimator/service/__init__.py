"""The daemon: what flies.

    link (Zenoh, MAVLink) -> Inbox -> Daemon: one loop around Fusion.handle -> Outbox (the links again)
                                          |-> Log (a thread of its own)

A link is an Inbox's source and an Outbox; ports.py says how little it must know. Links, log, state file and watchdog are shells:
whatever happens to them, the loop goes on.

    base -> autopilot -> mavlink, zenoh, log -> daemon, vision -> run, which puts everything together

May import estimator.frontend and what is below it, logs and models.
"""
