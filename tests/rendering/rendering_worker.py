"""Jobs that run in a process of their own, one a backend: ``python rendering_worker.py JOB FILE.npz``.

Prints nothing; leaves arrays in the file, named ``<case>/<view>/<field>``.
"""

import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import rendering_cases as cases

import twinlens as tl
from twinlens.camera import Camera, Rig


def truth_job() -> dict[str, np.ndarray]:
    """The truth of every rig, and of the points of the left view seen again by the right one."""
    scene = cases.scene()
    found = {}
    for name, rig in [*enumerate(cases.rigs()), ("crossed", cases.crossed_rig())]:
        truths = tl.ground_truth(scene, rig)
        for view, truth in enumerate(truths):
            found |= {f"{name}/{view}/{field.name}": np.asarray(getattr(truth, field.name)) for field in fields(truth)}
        if name != "crossed":
            found |= {f"{name}/again/{key}": value for key, value in seen_again(scene, rig, truths[0]).items()}
    sky = tl.ground_truth(scene, cases.rigs()[0], sky_disparity=True)
    return found | {f"sky/{view}/disparity": truth.disparity for view, truth in enumerate(sky)}


def seen_again(scene, rig, left) -> dict[str, np.ndarray]:
    """Positions of visible left pixels, and what the right camera's rays through the very same points hit."""
    rows, columns = np.nonzero(left.visible)
    chosen = np.random.default_rng(0).permutation(len(rows))[:40]
    rows, columns = rows[chosen], columns[chosen]
    right = rig.cameras[1]
    u = columns - left.disparity[rows, columns].astype(float)
    single = [Camera(1, 1, right.fx, right.fy, right.cx - a, right.cy - b) for a, b in zip(u, rows, strict=True)]
    truths = tl.ground_truth(scene, Rig(single, [rig.world_from_cams[1]] * len(single)))
    return {
        "left": left.position[rows, columns],
        "right": np.array([truth.position[0, 0] for truth in truths]),
        "left_id": left.object_id[rows, columns],
        "right_id": np.array([truth.object_id[0, 0] for truth in truths]),
    }


JOBS = {"truth": truth_job}

if __name__ == "__main__":
    job, file = sys.argv[1:]
    np.savez(Path(file), **JOBS[job]())
