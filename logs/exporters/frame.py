"""The estimate of a log as a pandas DataFrame. Needs landfix[export]."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from logs.evaluation.collected import ODOMETRY_TOPIC
from logs.exporters.columns import table
from logs.store.reader import LogError

if TYPE_CHECKING:
    import pandas as pd


def estimate_frame(log: str | os.PathLike[str], topic: str = ODOMETRY_TOPIC, rate_hz: float = 0.0) -> "pd.DataFrame":
    """A row per estimate, by UTC; columns: logs.exporters.columns. Raises LogError.

    topic: other poses; rate_hz: 0: all; attrs["origin"]: (lat_deg, lon_deg, alt_m) or None.
    """
    try:
        import pandas as pd  # noqa: PLC0415  (an extra)
    except ImportError:
        raise LogError("a DataFrame needs pandas: pip install 'landfix[export]'") from None
    rows = table(Path(log), topic, rate_hz)
    frame = pd.DataFrame(dict(rows.columns), index=pd.to_datetime(rows.columns["t_ns"], unit="ns", utc=True).rename("time"))
    frame.attrs["origin"] = rows.origin
    return frame
