"""Vision in a report: images of fixes and failures, landmarks around the flight."""

from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from estimator.strict_toml import ConfigError
from estimator.tools.overlay.files import Scenery, scenery
from estimator.tools.overlay.sheet import draw_from, find_images, spread
from logs.evaluation.collected import Collected
from logs.report.gather import FIX_TOPIC, Frame, Gathered
from logs.report.page import Illustrations, Shot
from logs.report.write import Illustrate
from logs.wire.images import Pixels
from models.maps.landmarks import Landmark
from models.messages import AidStatus, ImageName, Reason

_FIXES, _REFUSALS = 6, 6  # images of each
_WIDTH_PX: Final = 640
_QUALITY: Final = 80  # of the JPEG files
_MARGIN_M: Final = 50.0


class _Choice(NamedTuple):
    t_ns: int
    frame: Frame
    image: ImageName
    aid: AidStatus | None


def illustrations(log: Path, config: Path | None = None, rig: Path | None = None, map_file: Path | None = None) -> Illustrate:
    """As logs.report.write.write requires."""

    def illustrate(collected: Collected, gathered: Gathered) -> Illustrations:
        chosen = _choose(collected, gathered)
        around, note = _scenery(log, collected, config, rig, map_file)
        if not chosen:
            return Illustrations(_landmarks(around, collected), (), note)
        images, _ = find_images(log, {choice.image for choice in chosen})
        shots = [_shot(choice, images[choice.image], around) for choice in chosen if choice.image in images]
        return Illustrations(_landmarks(around, collected), shots, note)

    return illustrate


def _scenery(
    log: Path, collected: Collected, config: Path | None, rig: Path | None, map_file: Path | None
) -> tuple[Scenery | None, str]:
    try:
        return scenery(log, list(collected.attachments), config, rig, map_file), ""
    except ConfigError as error:
        if config or rig or map_file:
            raise
        return None, f"Without the map drawn in: {error}"


def _choose(collected: Collected, gathered: Gathered) -> list[_Choice]:
    aids = {aid.t_ns: aid for aid in collected.aids if aid.topic == FIX_TOPIC}
    fixes, refusals = list[_Choice](), dict[str, list[_Choice]]()
    for t_ns, frame in sorted(gathered.frames.items()):
        if frame.request is None or frame.request.left is None or (frame.fix is None and frame.report is None):
            continue
        choice = _Choice(t_ns, frame, frame.request.left, aids.get(t_ns))
        refused_as = _refusal(choice)
        if refused_as:
            refusals.setdefault(refused_as, []).append(choice)
        else:
            fixes.append(choice)
    each = -(-_REFUSALS // len(refusals)) if refusals else 0
    refused = [choice for kind in refusals.values() for choice in spread(kind, each)]
    return [*spread(fixes, _FIXES), *sorted(refused, key=lambda choice: choice.t_ns)]


def _refusal(choice: _Choice) -> str:
    if choice.frame.fix is None:
        return choice.frame.report.outcome if choice.frame.report else "no fix"
    return choice.aid.reason if choice.aid and choice.aid.reason not in {Reason.FUSED, Reason.ALIGNING} else ""


def _shot(choice: _Choice, image: Pixels, around: Scenery | None) -> Shot:
    frame = choice.frame
    pose = frame.fix or frame.request
    canvas = image if image.dtype == np.uint8 else cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)  # type: ignore[call-overload]
    if around is not None and pose is not None:
        canvas = draw_from(pose, canvas, around.rig, around.landmarks, frame.fix.landmarks if frame.fix else ())
    if canvas.shape[1] > _WIDTH_PX:
        canvas = cv2.resize(
            canvas, (_WIDTH_PX, round(canvas.shape[0] * _WIDTH_PX / canvas.shape[1])), interpolation=cv2.INTER_AREA
        )
    _, file = cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    refusal = _refusal(choice)
    return Shot(choice.t_ns, (refusal or "fused").replace("_", " "), _words(choice), file.tobytes(), not refusal)


def _words(choice: _Choice) -> str:
    fix, report, aid = choice.frame.fix, choice.frame.report, choice.aid
    if fix is None:
        why = (report.detail or report.outcome.replace("_", " ")) if report else ""
        found = f"{report.regions} regions, {report.candidates} candidates" if report else ""
        return f"{why} ({found})" if found else why
    many = f"{len(fix.landmarks)} landmark{'s' if len(fix.landmarks) > 1 else ''}"
    gate = f", {aid.test_ratio:.2g} of the gate" if aid and aid.innovation else ""
    detail = f", {aid.detail}" if aid and aid.detail else ""
    return f"{many} ({', '.join(fix.landmarks[:6])}), fit {fix.residual_px:.2f} px{gate}{detail}"


def _landmarks(around: Scenery | None, collected: Collected) -> list[Landmark]:
    if around is None:
        return []
    p = collected.estimate.p[np.isfinite(collected.estimate.p).all(axis=1), :2]
    low, high = p.min(axis=0), p.max(axis=0)
    east, north = (0.5 * (low + high)).tolist()
    return around.landmarks.near(north, east, 0.5 * float(np.linalg.norm(high - low)) + _MARGIN_M)
