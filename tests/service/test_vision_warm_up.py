"""After the warm-up vision has every kernel: looking at rendered villages, whatever the prior, compiles nothing."""

import json
import subprocess
import sys

from tests.service.flying import environment

_CODE = """
import gc, json
import numpy as np
from numba.core.dispatcher import Dispatcher

def kernels():
    found = (d for d in gc.get_objects() if isinstance(d, Dispatcher))
    return {(f"{d.__module__}.{d.__name__}", str(s)) for d in found for s in d.signatures}

from estimator.service.vision_warm_up import warm_up
warm_up()
warm = kernels()

from estimator.sight import Sight
from estimator.vision_requests import Shot
from models.messages import VisionRequest
from tests.estimator.sights import PLACE, village
seen, outcomes = village(), set()
sight = Sight(seen.rig, seen.map)
for k, sigma_m in enumerate((0.2, 1.0, 4.0, 10.0, 30.0, 100.0)):
    for turn, sides in enumerate(((0, 1), (0, None), (None, 1))):
        t_ns = (3 * k + turn + 1) * 10**8
        shots = [None if s is None else Shot(*seen.pairs[0][s], t_ns, t_ns, t_ns) for s in sides]
        covariance = np.diag(np.repeat([sigma_m, 0.02], 3) ** 2)
        request = VisionRequest(t_ns, t_ns, PLACE, (1.0, 0.0, 0.0, 0.0), covariance, None, None)
        outcomes.add(len(sight.look(request, tuple(shots))))
        sight.draw("aided")
new = [name for name, _ in kernels() - warm if not name.startswith("vision.synthetic")]
print(json.dumps({"warm": len(warm), "new": new, "outcomes": len(outcomes)}))
"""


def test_no_kernel_is_compiled_after_it() -> None:
    told = subprocess.run([sys.executable, "-c", _CODE], env=environment(), capture_output=True, text=True, check=True)
    said = json.loads(told.stdout)
    assert said["warm"] > 20
    assert said["new"] == []
    assert said["outcomes"] > 1  # some gave a fix, some did not
