"""Messages as bytes: ROS 2 CDR, type texts, axes and stamps. Begin with `codec` and `schemas`.

May import models.
"""
