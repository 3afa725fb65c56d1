"""/truth of an autopilot's log: simulator, else the autopilot's estimate.

p_n = place (lat, lon, height) about the origin,  v_n,  q_nb    of the simulator
"""

import numpy as np

from logs.importers import frames, recording
from logs.importers.recording import Stream, Times
from models.frames import Origin
from models.messages import Array, Vec3


def truth(t_ns: Times, lla: Array, v_n: Array, q_nb_wxyz: Array, known: Vec3 | None) -> tuple[Stream, Vec3]:
    """Truth and its origin: the log's, else the first position.

    lla (n, 3) deg, deg, m above the sea; v_n (n, 3) m/s; q_nb_wxyz (n, 4), any length; n > 0.
    """
    lat, lon, alt = lla[0].tolist()
    origin = known or (lat, lon, alt)
    p_n = np.array([Origin(*origin).to_ned(*place) for place in lla.tolist()])
    return recording.truth(t_ns, p_n, v_n, frames.normalised(q_nb_wxyz)), origin


def about(truth: Stream | None, own: Stream | None, messages: str) -> str:
    """Remark on the truth; `own`: the autopilot's estimate."""
    if truth is None:
        return f"no reference in it ({messages})"
    if truth is own:
        return f"/truth is {recording.AUTOPILOT}, of the same sensors: a reference, no ground truth"
    return "/truth is the state of the simulator"
