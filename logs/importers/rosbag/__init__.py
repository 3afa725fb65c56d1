"""ROS 2 and ROS 1 bags. Begin with `convert`.

May import logs.importers.sensors, logs.importers.settings, logs.store, logs.wire, models.
"""
