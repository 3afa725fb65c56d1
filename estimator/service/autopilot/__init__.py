"""Output to an autopilot, whatever the wire: its clock, the output policy, units and frames of its messages.

May import estimator.service.base, logs and models.
"""
