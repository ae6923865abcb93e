from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import pytest

from oppload_cli import stimulus

if TYPE_CHECKING:
    from pathlib import Path

SMALL = {"display.width": 160, "display.height": 120, "display.pixels_per_degree": 2.0}
AFTER_A_PAUSE = {"timing.before_s": 1.5, "timing.motion_s": 1.5}
ONSET, CONTACT = 45, 89
STIMULI = {
    "centre.avi": ("opplod2023/looming-disk-centre", AFTER_A_PAUSE),
    "beside.avi": ("opplod2023/looming-disk-off-centre", AFTER_A_PAUSE),
    "moving.avi": ("controls/translating-disk-direction", {}),
    "grating.avi": ("controls/sine-grating", {}),
}
MANIFEST = f"""file,label,onset_frame,contact_frame,motion
centre.avi,looming,{ONSET},{CONTACT},
beside.avi,looming,{ONSET},{CONTACT},
moving.avi,none,,,translating
grating.avi,none,,,grating
"""


@pytest.fixture(scope="session")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of four stimuli with their manifest, and the boxes that the truth gives."""
    folder = tmp_path_factory.mktemp("labelled")
    boxes: dict[str, dict[str, list[float]]] = {}
    for name, (wanted, changes) in STIMULI.items():
        (entry,) = (entry for entry in stimulus.find(wanted) if entry.name == wanted)
        protocol = entry.with_settings({**SMALL, **changes}).protocols()[0]
        written = stimulus.write(protocol, folder)
        shutil.move(written.video, folder / name)
        truth = stimulus.read_ground_truth(written.truth)
        if truth["looming"]:
            boxes[name] = {str(at): box_of(truth["frames"][at]) for at in (60, 75, 80, 85, 88)}
    (folder / "manifest.csv").write_text(MANIFEST)
    (folder / "boxes.json").write_text(json.dumps(boxes))
    return folder


def box_of(frame: dict[str, list[dict[str, float]]]) -> list[float]:
    (disk,) = frame["objects"]
    side = disk["angular_size_deg"] * SMALL["display.pixels_per_degree"]
    return [disk["centre_x_px"] - side / 2, disk["centre_y_px"] - side / 2, side, side]
