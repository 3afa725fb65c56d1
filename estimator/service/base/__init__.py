"""What all parts of the daemon share: the ports between them, the clock, the status that the health message is made of, secrets.

Begin with `ports`. May import estimator.strict_toml, logs and models; nothing else of the service.
"""
