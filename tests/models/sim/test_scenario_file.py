import pytest

from models.sim.scenario_file import ScenarioError, loads

WRONG = [
    ("durations_s = 3", "unknown key 'durations_s'; did you mean 'duration_s'?"),
    ("[imu]\nrate = 3", "unknown key 'rate' in [imu]; did you mean 'rate_hz'?"),
    ("[imu]\nxyz = 3", "unknown key 'xyz' in [imu] (known: grade, rate_hz,"),
    ("[vehicle]\nkind = 'multirotors'", "unknown kind 'multirotors' in [vehicle]; did you mean 'multirotor'?"),
    ("[vehicle]\nbank_deg = 30", "[vehicle] needs its kind, one of multirotor, fixed_wing"),
    ("[vehicle]\nkind = 'multirotor'\nbank_deg = 30", "unknown key 'bank_deg' in [vehicle]"),
    ("[vehicle]\nkind = 'fixed_wing'\nspeed_m_s = [20.0, 10.0]", "speed_m_s"),
    ("[[faults]]\nkind = 'spoof_jum'", "unknown kind 'spoof_jum' in [faults]; did you mean 'spoof_jump'?"),
    ("[[faults]]\nkind = 'spoof_jump'\noffset_m = [1, 2, 3]", "did you mean 'offset_n_m'?"),
    ("[[faults]]\nkind = 'jam'\nstart_s = 5.0\nend_s = 4.0", "start_s, end_s"),
    ("[[pose_fix.false_spans]]\nstart_s = 1\nend_s = 2\noffset = [1, 2, 3]", "unknown key 'offset' in [pose_fix.false_spans]"),
    ("[pose_fix]\ndelay_s = [5, 0]", "the smaller number first in 'pose_fix'"),
    ("[pose_fix]\ndelay_s = -1.0", "must be positive"),
    ("[gnss]\nsigma_m = [1, 2]", "expected array of length 3, got 2 in 'gnss.sigma_m'"),
    ("[gnss]\nrate_hz = -1", "expected float > 0.0 in 'gnss.rate_hz'"),
    ("[gnss]\nantenna_b_m = [0, nan, 0]", "gnss.antenna_b_m = nan: must be a finite number"),
    ("duration_s = inf", "duration_s = inf: must be a finite number"),
    ("imu = 3", "expected object, got int in 'imu'"),
    ("[imu]\ngrade = 'tactcal'", "'tactcal'"),
    ("geographic = false\n[gnss]", "no GNSS"),
    ("x = ", "not valid TOML"),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_a_wrong_file_gives_one_clear_line(text: str, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        loads(text, "flight.toml")
    line = str(caught.value)
    assert line.startswith("flight.toml: ")
    assert message in line
    assert "\n" not in line


def test_an_empty_file_is_a_scenario_of_defaults() -> None:
    assert loads("").duration_s == 120.0
