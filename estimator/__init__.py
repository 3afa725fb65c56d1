"""The estimator: an error-state Kalman filter that keeps an honest estimate while absolute fixes are rare, late or missing.

    fusion.Fusion.handle(message) -> outputs        the sans-I/O heart; daemon, replay, simulation and tests drive the same call

Below `fusion` there is no I/O, no clock and no thread. `replay`, `service`, `config` and `cli` are the shell around it.
May import logs, calib, vision and models.
"""
