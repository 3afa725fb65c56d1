"""An autopilot's attitude as a prior for the alignment.

Never fused in flight.
"""

from typing import Final

import numpy as np
from msgspec.structs import replace

from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.pose import PoseConfig, given_components, pose_aid
from models.messages import AttitudePrior, PoseFix, Reason

_CONFIG: Final = PoseConfig(tilt_deg=0.0, mount_deg=0.0)


def attitude_aid(prior: AttitudePrior) -> Aid | Refusal:
    """A pose without position, for the alignment only."""
    if np.shape(prior.covariance) != (3, 3):
        return Refusal(Reason.MALFORMED, "the covariance of an attitude is 3 x 3")
    if given_components(np.diag(np.r_[0.0, 0.0, 0.0, np.diag(prior.covariance)])).attitude != "full":
        return Refusal(Reason.UNSUPPORTED, "an attitude to begin with is given whole")
    covariance = np.full((6, 6), np.nan)
    covariance[3:, 3:] = prior.covariance
    fix = PoseFix(prior.t_ns, prior.arrived_ns, (0.0, 0.0, 0.0), prior.q_nb_wxyz, covariance, topic=prior.topic)
    aid = pose_aid(fix, _CONFIG)
    return aid if isinstance(aid, Refusal) else replace(aid, kind="attitude", alignment_only=True)
