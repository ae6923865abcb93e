"""An array of frames in, alarms out: a dark square that grows on a white ground."""

import numpy as np

import oppload_cli as oppload

frames = np.full((60, 240, 320), 255, np.uint8)
for index, frame in enumerate(frames):
    half = round(6 / (1 - index / 62))  # as an approach at constant speed
    frame[max(0, 120 - half) : 120 + half, max(0, 160 - half) : 160 + half] = 0
for record in oppload.analyse(frames, rate=30):
    if record["opplod"].alarm:
        print(f"alarm at {record.time_s:.2f} s, box {record['opplod'].box}")
        break
