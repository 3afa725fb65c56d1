"""landfix as a library: the public names of the packages below, and nothing else.

    fusion = landfix.Fusion(landfix.load_config(Path("vehicle.toml")).fusion())
    outputs = fusion.handle(landfix.ImuSample(t_ns, t_ns, gyro_b, accel_b))      one message in, estimates and decisions out
    landfix.replay(Path("flight.mcap"), Path("estimate.mcap"), config)           the same over a log
    landfix.evaluate(Path("estimate.mcap"))                                      how good it was

docs/library.md has a script that runs. May import every other package; no package imports it.
"""

from estimator.config import Config, ConfigError
from estimator.config import load as load_config
from estimator.config import parse as parse_config
from estimator.fusion import Fusion, FusionConfig
from estimator.replay.replay import replay
from estimator.replay.summary import ReplaySummary
from estimator.version import version
from logs.evaluation.evaluate import evaluate
from logs.evaluation.records import Evaluation
from logs.exporters.frame import estimate_frame
from logs.store.reader import LogError, LogReader, Record
from logs.store.recorder import Recorder
from logs.wire.codec import Decoder, Encoded, encode, encode_input
from models.frames import Origin
from models.messages import (
    AidStatus,
    AttitudePrior,
    Checkpoint,
    Estimate,
    GnssFix,
    GnssVelocity,
    Health,
    ImuSample,
    Input,
    Integrity,
    LandmarkFix,
    LastGnss,
    Mode,
    OdometryDelta,
    OdometryPose,
    Output,
    PoseFix,
    Reading,
    Reason,
    Reset,
    Tick,
    Unusable,
)
from models.radius import horizontal_radius
from models.state import E, NavState, X

__all__ = [
    "AidStatus",
    "AttitudePrior",
    "Checkpoint",
    "Config",
    "ConfigError",
    "Decoder",
    "E",
    "Encoded",
    "Estimate",
    "Evaluation",
    "Fusion",
    "FusionConfig",
    "GnssFix",
    "GnssVelocity",
    "Health",
    "ImuSample",
    "Input",
    "Integrity",
    "LandmarkFix",
    "LastGnss",
    "LogError",
    "LogReader",
    "Mode",
    "NavState",
    "OdometryDelta",
    "OdometryPose",
    "Origin",
    "Output",
    "PoseFix",
    "Reading",
    "Reason",
    "Record",
    "Recorder",
    "ReplaySummary",
    "Reset",
    "Tick",
    "Unusable",
    "X",
    "encode",
    "encode_input",
    "estimate_frame",
    "evaluate",
    "horizontal_radius",
    "load_config",
    "parse_config",
    "replay",
    "version",
]
