"""Images of all kinds in a process that has warmed up, as vision's worker does: prints what was compiled for them, as JSON.

compiled: as the daemon's own report counts it; new: kernels that have more signatures than after the warm-up.

python -m tests.estimator.service.vision.many_looks [RIGS]
"""

import gc
import json
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import product
from typing import Any

import cv2
import numpy as np
from numba.core.dispatcher import Dispatcher

from estimator.frontend.processor import Processor
from estimator.frontend.requests import Shot
from estimator.service.base import compilation
from logs.wire.codec import Encoded
from logs.wire.images import Pixels, encode_image
from logs.wire.schemas import STORE
from models import so3
from models.camera import StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array, VisionRequest, vec3
from tests.vision.pose.test_small_landmarks import boulders, house_and_boulders
from vision.synthetic import Conditions, WorldSpec, make_rig, make_world, render_pair
from vision.synthetic.night import counts, night

ORIGIN = (47.3977, 8.5456, 488.0)
NARROW, WIDE = np.array([0.3, 0.3, 0.3, 0.01, 0.01, 0.02]), np.array([3.0, 3.0, 2.0, 0.02, 0.02, 0.03])
RIGS = (
    make_rig(),
    make_rig(exact=True, distortion=()),
    make_rig(distortion=(-0.1, 0.02, 0.0, 0.0, 0.001)),
    make_rig(800, 600, 700.0, pitch_deg=-70.0),
    make_rig(320, 240, 300.0, exact=True),
)


def looks(rigs: int) -> Iterator[tuple[Processor, tuple[Pixels | None, Pixels | None], tuple[Array, Array], Array]]:
    """Vision with its map and rig, images, the true pose and the prior's sigmas; of the first rigs."""
    for seed, rig in enumerate(RIGS[:rigs]):
        layout = ("village", "lookalikes", "grid")[seed % 3]
        scene = make_world(seed, WorldSpec(layout, 160.0, painted=0.6, flat=0.3, unmapped=0.2, gone=0.1, sigma_m=0.2, rig=rig))  # type: ignore[arg-type]
        world = night(scene.world, np.random.default_rng(1)) if seed == 2 else scene.world
        processor = Processor(scene.rig_calibrated, scene.map)
        for k, height_m in enumerate((18.0, 45.0, 90.0, 160.0)):
            pose = np.array([4.0 * k, -3.0 * k, -height_m]), so3.matrix(so3.from_euler(0.03, -0.05, 0.7 * k))
            left, right = (np.array(p) for p in render_pair(world, scene.rig, *pose, Conditions(), np.random.default_rng(k)))
            grey = [np.asarray(cv2.cvtColor(p, cv2.COLOR_BGR2GRAY), np.uint8) for p in (left, right)]
            kinds = (left, right), (left, None), (None, grey[1]), (grey[0], grey[1])
            for (i, sigmas), (j, images) in product(enumerate((NARROW, WIDE, 8.0 * WIDE, 30.0 * WIDE)), enumerate(kinds)):
                if (seed + k + i + j) % len(kinds) == 0:  # a quarter: each two of rig, height, prior and images occur together
                    yield processor, images, pose, sigmas
            if (seed + k) % 2:
                yield processor, (counts(left), counts(right)), pose, WIDE
            else:
                yield processor, (np.zeros_like(left), right), pose, NARROW
    for flight in (boulders(1, NARROW), house_and_boulders(2, NARROW)):
        processor = Processor(flight.rig, LandmarkMap.from_landmarks(ORIGIN, list(flight.landmarks)))
        for images in (flight.images, (flight.images[0], None)):
            yield processor, images, (flight.p_n, flight.R_nb), NARROW
    yield from few()


def few() -> Iterator[tuple[Processor, tuple[Pixels | None, Pixels | None], tuple[Array, Array], Array]]:
    """One landmark alone, a round one, and one that the border cuts off."""
    rig, angle = RIGS[0], np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    disc = 5.0 * np.column_stack((np.cos(angle), np.sin(angle)))
    box = np.array([(-4.0, -7.0), (4.0, -7.0), (4.0, 7.0), (-4.0, 7.0)])
    for place, outline, height_m in ((0.0, box, 3.0), (0.0, disc, 3.0), (0.0, box, 0.0), (22.0, box, 3.0)):
        mark = Landmark.of("a", outline + np.array([0.0, place]), 0.0, height_m, (40, 40, 200), 0.1)
        pair = [_drawn(rig, mark, right=right) for right in (False, True)]
        processor = Processor(rig, LandmarkMap.from_landmarks(ORIGIN, [mark]))
        for sigmas in (NARROW, WIDE):
            yield processor, (pair[0], pair[1]), (np.array([0.0, 0.0, -50.0]), np.eye(3)), sigmas
            yield processor, (pair[0], None), (np.array([0.0, 0.0, -50.0]), np.eye(3)), sigmas


def _drawn(rig: StereoRig, mark: Landmark, *, right: bool) -> Pixels:
    camera = rig.right if right else rig.left
    p_nc, R_nc = (rig.right_camera_pose if right else rig.camera_pose)(np.array([0.0, 0.0, -50.0]), np.eye(3))
    image = np.random.default_rng(3).normal(110.0, 8.0, (camera.height, camera.width, 3)).clip(0, 255).astype(np.uint8)
    corners = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
    cv2.fillPoly(image, [np.round(camera.project((corners - p_nc) @ R_nc)).astype(np.int32)], (40, 40, 200))
    return image


def _shot(t_ns: int, image: Pixels, *, raw: bool) -> Shot:
    message = encode_image(t_ns, image, "", jpeg_quality=None if raw or image.dtype != np.uint8 else 92)
    return Shot("", message.schema, message.data, t_ns, t_ns, t_ns)


def _outcome(report: Encoded) -> str:
    report_of: Any = STORE.deserialize_cdr(report.data, report.schema)
    return str(report_of.outcome)


def _kernels() -> set[tuple[str, str]]:
    """Name and signature of every kernel that is compiled or loaded in this process."""
    found: list[Any] = [d for d in gc.get_objects() if isinstance(d, Dispatcher)]
    return {(f"{d.__module__}.{d.__name__}", str(signature)) for d in found for signature in d.signatures}


def main() -> None:
    from estimator.service.vision.warm_up import warm_up  # noqa: PLC0415

    warm_up()
    warm = _kernels()
    compiled = list[str]()
    compilation.listen(lambda kernel, _: compiled.append(kernel) if kernel else None)
    outcomes, count = Counter[str](), 0
    for processor, images, (p_n, R_nb), sigmas in looks(int(sys.argv[1]) if len(sys.argv) > 1 else len(RIGS)):
        count += 1
        t_ns = count * 10**9
        shots = [None if p is None else _shot(t_ns, p, raw=bool(count % 2)) for p in images]
        w, x, y, z = so3.from_matrix(np.ascontiguousarray(R_nb)).tolist()
        request = VisionRequest(t_ns, t_ns, vec3(p_n), (w, x, y, z), np.diag(sigmas**2), None, None)
        said = processor.process(request, (shots[0], shots[1]))
        outcomes[_outcome(said[0])] += 1
        processor.draw("aided")
    ours = [kernel for kernel in compiled if not kernel.startswith("vision.synthetic")]
    new = sorted({name for name, _ in _kernels() - warm if not name.startswith("vision.synthetic")})
    print(json.dumps({"warm": len(warm), "new": new, "looks": count, "compiled": ours, "outcomes": outcomes}))


if __name__ == "__main__":
    main()
