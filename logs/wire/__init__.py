"""Messages as bytes: ROS 2 CDR, the texts of the types, axes and stamps. The ROS conventions (ENU, FLU) end in `codec`.

Begin with `codec` and `schemas`. May import models.
"""
