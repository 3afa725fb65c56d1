"""/landfix/integrity: the fields of the message, both ways."""

from typing import Any, Final

import numpy as np

from logs.wire import schemas
from logs.wire.schemas import STORE
from models.messages import Alert, Integrity
from models.untrusted.toml_text import one_line

INTEGRITY_TOPIC: Final = "/landfix/integrity"


def fields(integrity: Integrity) -> dict[str, Any]:
    """All but the header."""
    return {
        "state": str(integrity.state),
        "reason": integrity.reason,
        "risk_per_hour": integrity.risk_per_hour,
        "hpl": integrity.hpl_m,
        "vpl": integrity.vpl_m,
        "hal": integrity.hal_m,
        "val": integrity.val_m,
        "risks_per_hour": np.array(integrity.risks_per_hour, dtype=np.float64),
        "hpls": np.array(integrity.hpls_m, dtype=np.float64),
        "vpls": np.array(integrity.vpls_m, dtype=np.float64),
        "sigma_h": integrity.sigma_h_m,
        "sigma_v": integrity.sigma_v_m,
    }


def decode_integrity(data: bytes, arrived_ns: int = 0) -> Integrity:
    """Our /landfix/integrity. Raises ValueError."""
    try:
        m: Any = STORE.deserialize_cdr(data, schemas.INTEGRITY)
        t_ns, state = int(m.header.stamp.sec) * 1_000_000_000 + int(m.header.stamp.nanosec), Alert(m.state)
    except Exception as error:  # whatever bytes from outside trip over, they are not of this type
        raise ValueError(str(error)) from error
    return Integrity(
        t_ns, arrived_ns or t_ns, state, one_line(m.reason), m.risk_per_hour, m.hpl, m.vpl, m.hal, m.val,
        tuple(m.risks_per_hour.tolist()), tuple(m.hpls.tolist()), tuple(m.vpls.tolist()), m.sigma_h, m.sigma_v,
    )  # fmt: skip
