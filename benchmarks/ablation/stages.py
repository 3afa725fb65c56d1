"""The stages of predict and verify, and how each is left out: its function is replaced by one that does nothing.

A stage that made no difference in a trial needs no second run there. `watched` finds out during the run with all stages, and
takes the time spent in each.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from vision import pipeline, recognise
from vision.identify.constellation import Constellation
from vision.predict import coarse_search, fit, predict, search_level, verify
from vision.records.reports import nothing

_GOOD_ODDS = 8.0  # between those that accept a fit at once and those that accept it whatever else is found


def _always(*_: object) -> bool:
    return True


class Stage(NamedTuple):
    """owner.attribute is replaced by without(original, *arguments); used(result, arguments): whether that may change anything.

    An attribute that is a number is replaced by without(original). saves: whether its time is saved where it is not used.
    """

    name: str
    owner: object
    attribute: str
    without: Callable[..., Any]
    used: Callable[[Any, Any], bool] = _always
    saves: bool = True


class Use(NamedTuple):
    """Of a stage in one trial: whether it may have changed the answer, and the time spent in it."""

    used: bool
    ms: float


def _no_positions(init: Callable[..., None], level: search_level.SearchLevel, *given: Any) -> None:
    init(level, *given)
    level.free[:] = 0.0


def _shares_only(_: object, fitter: Any, marks: Any, estimate: Any, seen: Any) -> Any:
    v = fitter._config
    return (seen.share >= v.landmark_found) & (fit._off_map(marks, estimate) < v.off_map)


def _most_likely(decided: Callable[..., Any], tried: Sequence[verify.Fitted | str], config: verify.VerifyConfig) -> Any:
    fits = [one for one in tried if isinstance(one, verify.Fitted)]
    return max(fits, key=lambda one: one.odds) if fits else decided(tried, config)


def _several(_: object, given: Any) -> bool:
    return sum(isinstance(one, verify.Fitted) for one in given[0]) > 1


def _not_among(original: Callable[..., Any], *given: Any) -> Any:
    """Small landmarks are searched again where a fit of the large ones puts them: there is no such fit."""
    return "" if len(given) > 5 else original(*given)


SEARCH = (
    Stage("own position of each landmark", search_level.SearchLevel, "__init__", _no_positions),
    Stage(
        "own size of each landmark", search_level, "_growths", lambda _, m, _px: np.zeros((1, len(m))), lambda r, _: len(r) > 1
    ),
    Stage("colour on the roof's side", search_level, "chromas", lambda _, marks: np.zeros((len(marks), 3)), lambda r, _: r.any()),
    Stage("middle level", coarse_search.Search, "_sizes", lambda f, s: [f(s)[0], f(s)[-1]], lambda r, _: len(r) > 2),
    Stage("finer levels", coarse_search.Search, "_sizes", lambda f, s: f(s)[-1:], lambda r, _: len(r) > 1),
    Stage("second step at a level", coarse_search.Search, "_climb", lambda _, _s, _level, at, _n: at, lambda r, a: r is not a[2]),
    Stage("small landmarks again", fit.Fitter, "fit", _not_among, lambda _, a: len(a) > 5, saves=False),
    Stage("nearer and farther", predict, "nearer_and_farther", lambda *_: [], lambda r, _: bool(r)),
    Stage("position from one landmark", fit.Fitter, "fit_one", lambda *_: None, lambda r, _: r is not None),
    Stage("second round", fit.Fitter, "joined", lambda *a: a[5], lambda r, a: r is not a[4]),
)
CHECKS = (
    Stage("votes before the fit", verify, "flaw", lambda *_: "", lambda r, _: bool(r)),
    Stage("final check of each landmark", fit.Fitter, "_present", lambda *a: np.ones(len(a[2]), bool), lambda r, _: not r.all()),
    Stage("presence test", fit.Fitter, "_present", _shares_only),
    Stage("error on the map", fit, "_off_map", lambda _, marks, _fit: np.zeros(len(marks)), lambda r, _: bool((r > 1.0).any())),
    Stage("right against left image", fit.Fitter, "_pair_flaw", lambda *_: "", lambda r, _: bool(r)),
    Stage("distance from search to fit", fit, "_moved_px", lambda *_: 0.0, lambda r, _: r > 10.0),
    Stage("fit against prior", fit, "pose_flaw", lambda *_: "", lambda r, _: bool(r)),
    Stage("odds of a position", fit, "position_odds", lambda *_: _GOOD_ODDS),
    Stage("share that is covered", fit, "position_odds", lambda f, *a: f(*a[:4], 0.0), lambda _, a: a[4] > 0.0),
    Stage("rival positions", verify, "decided", _most_likely, _several),
    Stage("the next image must agree", verify.Waiting, "agrees", lambda *_: True, lambda r, _: not r),
    Stage("contradiction by the image before", verify.Waiting, "holds", lambda *_: False, lambda r, _: r),
    Stage("one house further", predict.PredictPath, "stands_out", lambda *_: True, lambda r, _: not r),
    Stage("all outlines as one pattern", pipeline, "judged", lambda _, r, *_more: r, lambda r, a: r is not a[0]),
)
IDENTIFY = (
    Stage(
        "segmentation where prediction finds nothing", recognise.SegmentPath, "locate",
        lambda _, _path, _images, _near, t_ns, _prior: nothing(t_ns, "no_region", ""),
        lambda r, _: isinstance(r, recognise.Identified),
    ),
    Stage("regions of earlier images", Constellation, "recall", lambda *_: [], lambda r, _: bool(r)),
)  # fmt: skip
STAGES = (*SEARCH, *CHECKS, *IDENTIFY)


@contextmanager
def left_out(stage: Stage) -> Iterator[None]:
    """The pipeline without a stage."""
    original = getattr(stage.owner, stage.attribute)
    with patch.object(stage.owner, stage.attribute, _without(stage, original)):
        yield


def _without(stage: Stage, original: Any) -> Any:
    if not callable(original):
        return stage.without(original)
    return lambda *given: stage.without(original, *given)


@contextmanager
def watched(stages: Sequence[Stage] = STAGES) -> Iterator[dict[str, Use]]:
    """The whole pipeline, and the use of each stage by its name; those that replace a number count as used."""
    uses = {stage.name: Use(used=not callable(getattr(stage.owner, stage.attribute)), ms=0.0) for stage in stages}
    with ExitStack() as patches:
        for stage in stages:
            original = getattr(stage.owner, stage.attribute)
            if callable(original):
                patches.enter_context(patch.object(stage.owner, stage.attribute, _watching(stage, original, uses)))
        yield uses


def _watching(stage: Stage, original: Callable[..., Any], uses: dict[str, Use]) -> Callable[..., Any]:
    def call(*given: Any) -> Any:
        begin = time.process_time()
        result = original(*given)
        before = uses[stage.name]
        ms = before.ms + 1e3 * (time.process_time() - begin) * stage.saves
        uses[stage.name] = Use(bool(before.used or stage.used(result, given)), ms)
        return result

    return call
