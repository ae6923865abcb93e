"""The floors of the published detectors on the catalogue: the table of ``docs/detectors.md``."""

from __future__ import annotations

import pytest

from oppload_cli import stimulus
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.truth import contact_time
from tests.detection.test_catalogue_alarms import CONTROLS, HEIGHT, LOOM

Leads = dict[str, list[int | None]]

DISKS = 20, 40, 60, 80, 100  # ms, l/v
MOST = 8  # controls of 109 that may set an alarm off
LEADS: dict[str, tuple[int | None, ...]] = {  # frames before contact
    "ttc_gradient": (8, 8, 3, 5, 6),
    "lgmd1_group": (1, 2, 3, None, None),
    "lgmd1_group_paper": (1, 3, 4, 4, None),
    "lgmd1_single": (None,) * 5,
    "lgmd1_single_paper": (None,) * 5,
    "lgmd1_onoff": (2, 4, 5, 7, 8),
    "lgmd2": (6, 10, 14, 16, 19),
    "lgmd_plus": (5, 8, 10, 12, 14),
    "plgmd": (1, None, None, None, None),
    "lgmd_contrast": (1, 3, 4, 5, 5),
    "ci_lmd": (1, 3, 4, 5, 6),
    "emd_lplc2_gf": (7, 16, 24, 33, 41),
    "zhou_lrf": (4, 9, 13, 16, 18),
    "mlplc2": (None,) * 5,
    "hua_fixed": (None,) * 5,
    "hua_literal": (None,) * 5,
}


def first_alarms(stimuli: str, l_over_v: int | None = None) -> Leads:
    """The first frame with an alarm of every detector on the stimuli of a name."""
    found: Leads = {name: [] for name in LEADS}
    changes = {} if l_over_v is None else {"disk.growth.l_over_v_ms": l_over_v}
    for protocol in stimulus.load_all(stimuli, changes):
        video = StimulusVideo(protocol, HEIGHT)
        records = list(analyse(video, list(LEADS), places=None, rmo=None))
        for name, first in found.items():
            first.append(next((record.frame for record in records if record[name].alarm), None))
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    "l_over_v",
    [disk if disk == 40 else pytest.param(disk, marks=pytest.mark.slow) for disk in DISKS],
)
def test_a_looming_disk_alarms_as_early_as_the_page_says(l_over_v: int) -> None:
    [protocol] = stimulus.load_all(LOOM, {"disk.growth.l_over_v_ms": l_over_v})
    contact = contact_time(protocol)
    assert contact is not None
    for name, [first] in first_alarms(LOOM, l_over_v).items():
        expected = LEADS[name][DISKS.index(l_over_v)]
        assert (first is None) == (expected is None), name
        if first is not None and expected is not None:
            assert contact * 30 - first == pytest.approx(expected, abs=1), name


@pytest.mark.slow
def test_few_controls_set_an_alarm_off() -> None:
    count = dict.fromkeys(LEADS, 0)
    shown = 0
    for control in CONTROLS:
        found = first_alarms(control)
        shown += len(found["lgmd2"])
        for name, alarms in found.items():
            count[name] += sum(first is not None for first in alarms)
    assert shown == 109
    assert {name: number for name, number in count.items() if number > MOST} == {}
