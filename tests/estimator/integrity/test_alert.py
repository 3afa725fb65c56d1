import math

from estimator.integrity.alert import Judge, Levels
from estimator.integrity.config import IntegrityConfig
from models.messages import Alert

CONFIG = IntegrityConfig(hal_m=10.0, val_m=20.0)
S = 1_000_000_000
GOOD, WIDE = Levels(5.0, 5.0), Levels(30.0, 5.0)


def test_without_a_limit_nothing_is_judged() -> None:
    assert Judge(IntegrityConfig()).judge(0, WIDE, WIDE) is Alert.NOT_JUDGED


def test_the_state_follows_from_both_risks() -> None:
    assert Judge(CONFIG).judge(0, GOOD, GOOD) is Alert.USABLE
    assert Judge(CONFIG).judge(0, WIDE, GOOD) is Alert.CAUTION
    assert Judge(CONFIG).judge(0, WIDE, WIDE) is Alert.DO_NOT_USE
    assert Judge(CONFIG).judge(0, Levels(5.0, 25.0), GOOD) is Alert.CAUTION
    assert Judge(CONFIG).judge(0, Levels(math.nan, 5.0), Levels(math.nan, 5.0)) is Alert.DO_NOT_USE


def test_a_limit_that_is_not_given_judges_nothing() -> None:
    assert Judge(IntegrityConfig(hal_m=10.0)).judge(0, Levels(5.0, math.inf), GOOD) is Alert.USABLE


def test_worse_at_once_and_better_after_two_seconds() -> None:
    judge = Judge(CONFIG)
    assert judge.judge(0, GOOD, GOOD) is Alert.USABLE
    assert judge.judge(S // 5, WIDE, WIDE) is Alert.DO_NOT_USE
    assert judge.judge(2 * S // 5, GOOD, GOOD) is Alert.DO_NOT_USE
    assert judge.judge(S, WIDE, WIDE) is Alert.DO_NOT_USE  # the wait begins anew
    assert judge.judge(2 * S, GOOD, GOOD) is Alert.DO_NOT_USE
    assert judge.judge(4 * S - 1, GOOD, GOOD) is Alert.DO_NOT_USE
    assert judge.judge(4 * S, GOOD, GOOD) is Alert.USABLE


def test_a_level_at_the_limit_does_not_flicker() -> None:
    judge = Judge(CONFIG)
    states = [judge.judge(k * S, Levels(10.2 if k % 5 == 0 else 9.8, 5.0), GOOD) for k in range(60)]
    assert set(states) == {Alert.CAUTION}
