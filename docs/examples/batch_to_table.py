"""Many inputs to one table, the strongest first."""

import pandas as pd

import oppload_cli as oppload

names = ["controls/looming-perspective", "controls/receding-patch", "controls/size-steps"]
results = {name: oppload.run(name, rmo=False) for name in names}
rows = {name: result.summary["opplod"] for name, result in results.items()}
table = pd.DataFrame.from_dict(rows, orient="index").sort_values("peak", ascending=False)
print(table[["peak", "peak_time_s", "first_alarm_time_s", "alarm_frames"]])
