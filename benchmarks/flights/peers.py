"""Published estimators on the same scenarios, as they were measured: the yardstick with our own figures.

Medians over 11 sequences (EuRoC MH_01 03 04 05, V1_01-03, V2_01-03, Blackbird clover) and seeds 0-2; compare the EuRoC rows. m,
degrees; end: at an outage's end. Measured once with other programs; C, L, V, W were not run.
"""

from typing import TypeAlias

Row: TypeAlias = dict[str, float]


def _rows(columns: str, **peers: str) -> dict[str, Row]:
    keys = columns.split()
    return {
        name: {key: float(value) for key, value in zip(keys, values.split(), strict=True) if value != "-"}
        for name, values in peers.items()
    }


_OUTAGES = "pos_m att_deg rmse_5 end_5 rmse_10 end_10 rmse_30 end_30 nees_out"

PEERS: dict[str, dict[str, Row]] = {
    "N": _rows(
        "pos_m att_deg nees_p nees_a",
        ekf2_stock="104 104 82.1 14.5",
        ekf2p_tuned="0.195 0.546 1.02 1.6",
        rednose_strap="0.179 0.474 0.899 1.71",
        mars="0.195 0.441 0.953 1.55",
        kfgins="0.179 0.473 0.899 1.7",
        gtsam_isam2="0.179 0.472 - -",
        filterpy="0.179 0.472 0.9 1.7",
    ),
    "A": _rows(
        _OUTAGES,
        ekf2p_tuned="0.212 0.548 0.812 1.54 2.07 4.43 16.2 37.8 0.92",
        rednose_loc="0.179 0.445 0.668 1.25 1.43 3.17 15 33.4 0.864",
        mars="0.192 0.42 0.638 1.3 1.44 3.22 13.5 32 0.82",
        kfgins="0.179 0.426 0.656 1.23 1.48 3.05 14.2 31.2 0.889",
        gtsam_isam2="0.179 0.432 0.674 1.24 1.41 3.16 15.3 34.1 -",
        filterpy="0.178 0.431 0.665 1.23 1.43 3.18 15.2 33.5 0.879",
    ),
    "B": _rows(
        "pos_m att_deg rmse_60 end_60 nees_out",
        ekf2p_tuned="0.237 0.659 75.5 195 0.724",
        rednose_strap="0.181 0.467 66.2 159 0.811",
        mars="0.189 0.438 67.3 165 0.857",
        kfgins="0.181 0.465 68.7 158 0.759",
        gtsam_isam2="0.181 0.467 66.2 158 -",
        filterpy="0.181 0.468 66 157 0.794",
    ),
    "D": _rows(
        _OUTAGES,
        ekf2p_tuned="0.241 0.57 0.815 1.54 2.09 4.45 16.2 37.8 0.996",
        rednose_loc="0.194 0.451 0.668 1.25 1.43 3.17 15 33.4 0.861",
        mars="0.207 0.425 0.638 1.3 1.44 3.22 13.5 32 0.817",
        kfgins="0.241 1.51 0.699 1.44 1.58 3.43 19.7 47.4 1.16",
        gtsam_isam2="0.194 0.438 0.674 1.24 1.41 3.16 15.3 34.1 -",
        filterpy="0.243 1.51 0.721 1.42 1.61 3.66 18.9 44.9 1.16",
    ),
    "F": _rows(
        _OUTAGES,
        ekf2_stock="0.134 0.9 0.678 1.31 1.82 3.85 11.4 25.8 0.534",
        ekf2p_tuned="0.112 0.473 0.664 1.32 1.72 3.61 10.9 25.5 0.65",
        rednose_strap="0.0982 0.315 0.527 1.12 1.68 3.59 10 23.6 1.09",
        mars="0.101 0.316 0.568 1.12 1.58 3.45 9.77 24 1.12",
        kfgins="0.0975 0.316 0.53 1.13 1.62 3.45 11 26.2 1.08",
        gtsam_isam2="0.0982 0.315 0.529 1.11 1.68 3.57 9.68 23.2 -",
        filterpy="0.0975 0.315 0.53 1.11 1.68 3.57 10.1 23.6 1.09",
    ),
    "X": _rows(
        "pos_m att_deg nees_p nees_a end_30",
        ekf2p_tuned="0.222 0.572 1.12 1.34 38.2",
        rednose_strap="3.62 2.4 361 46.4 69.4",
        mars_chi2="0.19 0.439 0.853 1.25 32.5",
        gtsam_ifl_cauchy="0.232 0.506 - - 32.7",
        filterpy="3.63 2.4 361 47.3 77.4",
    ),
    "G": _rows(
        "pos_m att_deg end_5 end_10 end_30 nees_p",
        ekf2p_tuned="0.701 8.06 2.3 4.98 33.8 2.18",
        kfgins="0.39 6.47 2.79 5.53 34.9 0.911",
        gtsam_isam2="0.367 5.12 2.39 4.55 33.3 -",
        filterpy="0.413 8.33 3.09 6.34 37 0.972",
    ),
}
