"""Write the picture of docs/annotated.md: python docs/generate_annotated.py."""

from __future__ import annotations

import tempfile
from pathlib import Path

import av
import cv2

from oppload_cli import stimulus
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import Outputs, Task

STIMULUS = "controls/looming-and-translating"  # the video of the tutorials
PICTURE = Path(__file__).parent / "annotated.png"
WIDTH = 640  # px
AFTER_ALARM = 4  # frames


def main() -> None:
    """Annotate a stimulus, and save a frame in which OppLoD's alarm is on."""
    with tempfile.TemporaryDirectory() as name:
        folder, settings = Path(name), resolve(measure_rmo=False)
        video = stimulus.write(stimulus.load(STIMULUS), folder).video
        outputs = Outputs.of(folder, "stimulus", settings.models, annotate=True)
        outcome = run_task(Task(str(video), settings, outputs))
        first = outcome.summaries["opplod"].first_alarm_frame or 0
        with av.open(str(outputs.annotated)) as container:
            frames = enumerate(container.decode(video=0))
            shown = next(frame for at, frame in frames if at == first + AFTER_ALARM)
        picture = shown.to_ndarray(format="bgr24")
    size = (WIDTH, round(WIDTH * picture.shape[0] / picture.shape[1]))
    cv2.imwrite(str(PICTURE), cv2.resize(picture, size, interpolation=cv2.INTER_AREA))


if __name__ == "__main__":
    main()
