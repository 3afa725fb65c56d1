"""One trial of the ablation: answered by the whole pipeline, and by the pipeline without each stage that made a difference."""

import time

import msgspec

from benchmarks.ablation.stages import STAGES, left_out, watched
from benchmarks.ablation.trials import SETS, Trial, drawn
from estimator.bench.recognisers import Verdict
from vision.pipeline import LandmarkPipeline

WHOLE = "(all stages)"


class Answer(msgspec.Struct, frozen=True):
    """verdict, and processor time for the first frame, without a stage; same: not run, as the stage made no difference."""

    verdict: Verdict
    ms: float
    same: bool = False


class Outcome(msgspec.Struct, frozen=True):
    """One trial: its group, and the answers by the stage that was left out."""

    group: str
    answers: dict[str, Answer]


def run(job: tuple[str, int, int, tuple[str, ...]]) -> Outcome:
    """One trial by the whole pipeline and without each of the stages named."""
    name, seed, number, stages = job
    trial = drawn(next(s for s in SETS if s == name), seed, number)
    if trial is None:
        return Outcome("", {})
    answered(trial, frames=1)  # tables that are built once a flight are not timed
    with watched() as uses:
        whole = answered(trial)
    answers = {WHOLE: whole}
    for stage in (one for one in STAGES if one.name in stages):
        use = uses[stage.name]
        if use.used:
            with left_out(stage):
                answers[stage.name] = answered(trial)
        else:
            answers[stage.name] = Answer(whole.verdict, whole.ms - use.ms, same=True)
    return Outcome(trial.group, answers)


def answered(trial: Trial, frames: int | None = None) -> Answer:
    """What the pipeline makes of a trial."""
    pipeline = LandmarkPipeline(trial.rig, trial.landmarks, trial.config)
    verdict: Verdict = "silent"
    ms = 0.0
    for k, frame_of in enumerate(trial.frames[:frames]):
        frame = frame_of()
        begin = time.process_time()
        result = pipeline.process(frame.left, frame.right, frame.t_ns, frame.prior)
        ms = ms if k else 1e3 * (time.process_time() - begin)
        verdict = frame.judge(result)
        if not trial.goes_on(result, verdict):
            break
    return Answer(verdict, ms)
