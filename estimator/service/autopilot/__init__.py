"""What an autopilot is sent, whatever the wire: its clock, which output it may have when, the units and frames of its messages.

May import estimator.service.base, logs and models. MAVLink and PX4's Zenoh keys both use it.
"""
