"""ROS 2 (MCAP, sqlite3) and ROS 1 bags, sensors by type and content. Begin with `convert`.

May import logs.importers.sensors, logs.importers.settings, logs.store, logs.wire and models.
"""
